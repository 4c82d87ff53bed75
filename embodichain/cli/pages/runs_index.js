// The index of runs: sorts and searches its table, and compares two runs that are ticked.
// Text becomes text: nothing here makes HTML of it.
"use strict";

const table = document.getElementById("runs");
const body = table.tBodies[0];
const rows = [...body.rows];
const data = JSON.parse(document.getElementById("data").textContent);
const runOf = new Map(rows.map((row, index) => [row, data.runs[index]]));

// -- sort ------------------------------------------------------------------------------------------

for (const head of table.querySelectorAll("th[data-sort]")) {
  const button = document.createElement("button");
  button.type = "button";
  button.append(...head.childNodes);
  head.append(button);
  button.addEventListener("click", () => sortBy(head));
}

function sortBy(head) {
  const key = head.dataset.sort;
  const isNumber = key !== "run" && key !== "kind" && key !== "begun";
  // Numbers and dates begin with the largest, names with the first of the alphabet.
  const first = isNumber || key === "begun" ? "descending" : "ascending";
  const other = first === "ascending" ? "descending" : "ascending";
  const order = head.getAttribute("aria-sort") === first ? other : first;
  const sign = order === "ascending" ? 1 : -1;
  for (const each of table.querySelectorAll("th[aria-sort]")) each.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", order);
  const text = (row) => row.querySelector(`[data-${key}]`).getAttribute(`data-${key}`);
  rows.sort((a, b) => {
    const [left, right] = [text(a), text(b)];
    if (left === "" || right === "") return (left === "") - (right === ""); // always at the end
    if (isNumber) return sign * (left - right);
    return sign * left.localeCompare(right, "en", { numeric: true });
  });
  body.append(...rows);
}

// -- search ----------------------------------------------------------------------------------------

const search = document.getElementById("search");

function filter() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  let shown = 0;
  for (const row of rows) {
    const text = row.textContent.toLowerCase();
    row.hidden = !words.every((word) => text.includes(word));
    shown += !row.hidden;
  }
  const runs = rows.length === 1 ? "1 run" : `${rows.length} runs`;
  document.getElementById("count").textContent =
    shown === rows.length ? runs : `${shown} of ${runs}`;
}

search.addEventListener("input", filter);

// -- compare ---------------------------------------------------------------------------------------

const compared = document.getElementById("compared");
let ticked = [];

for (const row of rows) {
  const box = row.querySelector("input");
  box.hidden = false;
  box.checked = false;
  box.addEventListener("change", () => {
    ticked = ticked.filter((other) => other !== row);
    if (box.checked) ticked.push(row);
    for (const other of ticked.splice(0, ticked.length - 2)) {
      other.querySelector("input").checked = false; // the one that was ticked first
    }
    for (const other of rows) other.classList.toggle("ticked", ticked.includes(other));
    compare();
  });
}

function compare() {
  const hints = ["Tick two runs to compare them.", "Tick one more.", ""];
  document.getElementById("hint").textContent = hints[ticked.length];
  compared.hidden = ticked.length < 2;
  compared.replaceChildren();
  if (compared.hidden) return;
  const runs = ticked.map((row) => runOf.get(row));
  const names = ticked.map((row) => row.querySelector(".folder").textContent);
  compared.append(element("h2", {}, "Comparison"), legend(names));
  const titles = new Set(runs.flatMap((run) => Object.keys(run.curves ?? {})));
  const charts = element("div", { class: "charts" });
  for (const title of titles) charts.append(chart(title, runs.map((run) => run.curves?.[title])));
  compared.append(charts);
  section("Results", runs.map((run) => new Map(run.results)), names, false);
  const configs = runs.map((run) => new Map(run.config.map((line) => data.lines[line])));
  section("Differences of the config", configs, names, true);
  compared.scrollIntoView({ block: "nearest" });
}

function section(title, maps, names, onlyDifferences) {
  const lines = element("table");
  lines.append(tableRow("th", ["", ...names]));
  for (const key of new Set(maps.flatMap((map) => [...map.keys()]))) {
    const values = maps.map((map) => map.get(key));
    if (onlyDifferences && values[0] === values[1]) continue;
    lines.append(tableRow("td", [key, ...values.map((value) => value ?? "–")]));
  }
  const folded = element("details");
  folded.open = lines.rows.length <= 40;
  folded.append(element("summary", {}, title));
  folded.append(lines.rows.length > 1 ? lines : element("p", { class: "soft" }, "none"));
  compared.append(folded);
}

function tableRow(cell, texts) {
  const row = element("tr");
  row.append(...texts.map((text, i) => element(i ? cell : "th", {}, text)));
  return row;
}

function legend(names) {
  const list = element("ul", { class: "legend" });
  names.forEach((name, i) => {
    const sample = svg("svg", { viewBox: "0 0 14 10" });
    sample.append(svg("path", { class: `sample c${i}`, d: "M0 5H14" }));
    const item = element("li", {}, name);
    item.prepend(sample);
    list.append(item);
  });
  return list;
}

// -- a chart ---------------------------------------------------------------------------------------

function chart(title, curves) {
  const [width, height, left, right, top, bottom] = [400, 210, 46, 10, 10, 38];
  const drawn = curves.filter(Boolean);
  const lastX = Math.max(1e-9, ...drawn.flatMap((curve) => curve.x));
  const isShare = title === "success rate";
  const ticks = isShare ? [0, 0.25, 0.5, 0.75, 1] : ticksOf(drawn.flatMap((curve) => curve.y));
  const [low, high] = [ticks[0], ticks.at(-1)];
  const x = (value) => left + (value / lastX) * (width - left - right);
  const y = (value) => height - bottom - ((value - low) / (high - low)) * (height - top - bottom);
  const picture = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title });
  const label = (text, attributes) => {
    const line = svg("text", attributes);
    line.textContent = text;
    picture.append(line);
  };
  for (const tick of ticks) {
    picture.append(svg("path", { class: "grid", d: `M${left} ${y(tick)}H${width - right}` }));
    const text = isShare ? `${100 * tick}%` : short(tick);
    label(text, { "text-anchor": "end", x: left - 6, y: y(tick) + 4 });
  }
  for (const tick of ticksOf([0, lastX]).filter((value) => value <= lastX)) {
    label(short(tick), { "text-anchor": "middle", x: x(tick), y: height - bottom + 16 });
  }
  label(drawn[0].label, { "text-anchor": "middle", x: (left + width - right) / 2, y: height - 6 });
  curves.forEach((curve, i) => {
    if (!curve) return;
    const points = curve.x.map((value, k) => [x(value).toFixed(1), y(curve.y[k]).toFixed(1)]);
    if (points.length > 2) {
      picture.append(svg("path", { class: `line c${i}`, d: `M${points.map((p) => p.join(" ")).join("L")}` }));
    } else {
      for (const [cx, cy] of points) picture.append(svg("circle", { class: `dot c${i}`, cx, cy, r: 3.5 }));
    }
  });
  const figure = element("figure", { class: "chart" });
  const caption = element("figcaption");
  caption.append(element("b", {}, title));
  figure.append(caption, picture);
  return figure;
}

function ticksOf(values) {
  let [low, high] = [Math.min(...values), Math.max(...values)];
  const isConstant = high - low < 0.01 * Math.max(Math.abs(low), Math.abs(high));
  if (isConstant || (low > 0 && low < 0.35 * high)) [low, high] = [Math.min(low, 0), Math.max(high, 0)];
  if (low === high) high = low + 1;
  const rough = (high - low) / 4;
  const magnitude = 10 ** Math.floor(Math.log10(rough));
  const step = magnitude * [1, 2, 2.5, 5, 10].find((nice) => nice * magnitude >= rough * 0.999);
  const ticks = [];
  const first = Math.floor(low / step + 1e-9);
  for (let i = first; i <= Math.ceil(high / step - 1e-9); i++) ticks.push(i * step);
  return ticks;
}

function short(value) {
  const formats = { notation: "compact", maximumSignificantDigits: 4 };
  return new Intl.NumberFormat("en", formats).format(value).replace("K", "k");
}

// -- elements --------------------------------------------------------------------------------------

function element(name, attributes = {}, text = "") {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

function svg(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

document.getElementById("tools").hidden = false;
filter();
