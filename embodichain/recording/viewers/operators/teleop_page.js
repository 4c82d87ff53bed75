// The operator's part of the page of `viewer=web policy=teleop`; operator_pages.py has the messages.
// It is loaded before Studio's script, so that its keys do not reach Studio.
"use strict";
(() => {
  const CSS = `
    #teleop { position: fixed; top: 8px; right: 8px; width: 300px; padding: 10px 12px; z-index: 10;
      font: 12px/1.3 system-ui, sans-serif; color: #eee; background: rgba(24, 26, 32, 0.88);
      border-radius: 6px; user-select: none; }
    #teleop h1 { font-size: 14px; margin: 0 0 4px; }
    #teleop table { border-collapse: collapse; width: 100%; }
    #teleop td, #teleop th { padding: 1px 4px 1px 0; text-align: right; font-weight: normal;
      font-variant-numeric: tabular-nums; }
    #teleop th, #teleop .keys td, #teleop td:first-child { text-align: left; color: #aab; }
    #teleop .keys td:first-child { color: #fff; white-space: pre; }
    #teleop .bar { display: flex; gap: 8px; align-items: center; margin: 4px 0; }
    #teleop input { flex: 1; }
    #teleop .live { color: #6fdc8c; } #teleop .idle { color: #ffb454; }
    #teleop hr { border: 0; border-top: 1px solid #445; margin: 6px 0; }
    #teleop-handle { position: fixed; width: 26px; height: 26px; margin: -16px; z-index: 11;
      border: 3px solid #ffb454; border-radius: 50%; cursor: grab; touch-action: none; }
    #teleop-handle.held { cursor: grabbing; border-color: #6fdc8c; }`;
  const HEARTBEAT = 100; // ms
  const RETRY = 1000; // ms
  const BAR = 32; // px, Studio's bar below the picture
  const held = new Set();
  let socket = null, keys = new Set(), operator = false, status = null;
  let speed = 1, drag = null, sent = "";

  function element(tag, parent, text, className) {
    const made = document.createElement(tag);
    if (text !== undefined) made.textContent = text;
    if (className) made.className = className;
    parent.append(made);
    return made;
  }

  // -- the panel ---------------------------------------------------------------------------------

  const panel = document.createElement("div");
  panel.id = "teleop";
  const title = element("h1", panel);
  const role = element("div", panel, "connecting");
  role.id = "teleop-role";
  const progress = element("div", panel);
  progress.id = "teleop-progress";
  const last = element("div", panel);
  last.id = "teleop-last";
  const poses = element("table", panel);
  poses.id = "teleop-poses";
  const bar = element("label", panel, "speed", "bar");
  const slider = element("input", bar);
  Object.assign(slider, { type: "range", min: -1, max: 2, step: 0.25, value: 0, id: "teleop-speed" });
  const factor = element("span", bar, "1 x");
  const help = element("div", panel);
  element("hr", help);
  const keyTable = element("table", help, undefined, "keys");
  const padTable = element("table", help, undefined, "keys");
  padTable.hidden = true;
  element("div", panel, "H: help on and off", "idle");
  const handle = document.createElement("div");
  handle.id = "teleop-handle";
  handle.title = "drag: the tool follows in the plane of the view; wheel: away and back";
  handle.hidden = true;

  slider.addEventListener("input", () => {
    speed = 2 ** Number(slider.value);
    factor.textContent = `${Number(speed.toPrecision(2))} x`;
    slider.blur(); // keys move the robot, not the slider
    level();
  });

  function degrees(x, y, z, w) {
    // roll, pitch, yaw about fixed axes, R = Rz Ry Rx
    const roll = Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y));
    const pitch = Math.asin(Math.max(-1, Math.min(1, 2 * (w * y - z * x))));
    const yaw = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
    return [roll, pitch, yaw].map((angle) => ((angle * 180) / Math.PI).toFixed(0));
  }

  function pose(name, [x, y, z, qw, qx, qy, qz]) {
    const row = element("tr", poses);
    row.dataset.name = name;
    element("td", row, name);
    for (const metres of [x, y, z]) element("td", row, (metres * 1000).toFixed(0));
    for (const angle of degrees(qx, qy, qz, qw)) element("td", row, `${angle}°`);
  }

  function draw() {
    role.textContent = operator ? "you move the robot" : socket ? "watching: another page moves it"
      : "not connected: the robot stays where it is";
    role.className = operator ? "live" : "idle";
    handle.hidden = !(operator && status && status.handle);
    if (!status || !status.tool) return;
    const tools = status.tools.length > 1 ? `${status.tools[status.active]}, ` : "";
    const gripper = status.open === null ? "" : status.open ? ", gripper open" : ", gripper closed";
    title.textContent = `${tools}${status.axes} axes${gripper}`;
    const limit = status.max_steps > 0 ? ` of ${status.max_steps}` : "";
    const done = status.success ? ": success" : "";
    progress.textContent =
      `episode ${status.episode}, step ${status.step}${limit}, ${status.seconds.toFixed(1)} s${done}`;
    progress.className = status.success ? "live" : "";
    last.textContent = status.last;
    poses.replaceChildren();
    const head = element("tr", poses);
    for (const text of ["mm, degrees", "x", "y", "z", "roll", "pitch", "yaw"]) {
      element("th", head, text);
    }
    pose("tool", status.tool);
    for (const [name, value] of Object.entries(status.objects)) pose(name, value);
    if (status.handle) {
      const [u, v] = status.handle, half = (window.innerHeight - BAR) / 2;
      handle.style.left = `${window.innerWidth / 2 + u * half}px`;
      handle.style.top = `${half - v * half}px`;
    }
  }

  function row(table, shown, meaning) {
    const made = element("tr", table);
    element("td", made, shown);
    element("td", made, meaning);
  }

  function greet(hello) {
    keyTable.replaceChildren();
    const mouse = [["ring", "drag it: the tool follows in the view's plane"]];
    for (const [shown, meaning] of [...hello.keys, ...mouse]) row(keyTable, shown, meaning);
    padTable.replaceChildren();
    for (const [shown, meaning] of hello.pad) row(padTable, shown, meaning);
    keys = new Set(hello.codes);
  }

  // -- messages ----------------------------------------------------------------------------------

  function connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const opened = new WebSocket(`${scheme}//${location.host}/teleop`);
    opened.onopen = () => { socket = opened; level(true); };
    opened.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.hello) return greet(message.hello);
      status = message;
      operator = message.operator;
      draw();
    };
    opened.onclose = () => {
      socket = null;
      operator = false;
      release();
      draw();
      setTimeout(connect, RETRY);
    };
  }

  function gamepad() {
    const pad = navigator.getGamepads().find((one) => one && one.connected);
    if (!pad) return { axes: [], buttons: [] };
    padTable.hidden = false;
    const down = [...pad.buttons.keys()].filter((index) => pad.buttons[index].pressed);
    return { axes: pad.axes.slice(0, 4), buttons: down };
  }

  // What is held: at once when it changes, and as a heartbeat.
  function level(beat) {
    if (!socket || socket.readyState !== WebSocket.OPEN) return;
    const message = JSON.stringify(
      { held: [...held], ...gamepad(), speed, drag, away: document.hidden });
    if (beat || message !== sent) {
      sent = message;
      socket.send(message);
    }
  }

  function release() {
    held.clear();
    drag = null;
    handle.classList.remove("held");
    level();
  }

  // -- keys, mouse, gamepad ----------------------------------------------------------------------

  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.code === "KeyH" && !event.repeat) help.hidden = !help.hidden;
    if (keys.size && !keys.has(event.code) && event.code !== "KeyH") return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.repeat || !socket) return;
    held.add(event.code);
    socket.send(JSON.stringify({ press: event.code }));
    level();
  }, true);
  window.addEventListener("keyup", (event) => {
    if (held.delete(event.code)) {
      event.preventDefault();
      event.stopImmediatePropagation();
      level();
    }
  }, true);
  window.addEventListener("blur", release);
  document.addEventListener("visibilitychange", release);

  function at(event) {
    const half = (window.innerHeight - BAR) / 2;
    return [(event.clientX - window.innerWidth / 2) / half, (half - event.clientY) / half];
  }
  handle.addEventListener("pointerdown", (event) => {
    handle.setPointerCapture(event.pointerId);
    handle.classList.add("held");
    drag = { at: at(event), depth: 0 };
    level();
  });
  handle.addEventListener("pointermove", (event) => {
    if (!drag) return;
    drag.at = at(event);
    level();
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    handle.addEventListener(name, () => {
      drag = null;
      handle.classList.remove("held");
      level();
    });
  }
  handle.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (!drag) return;
    drag.depth -= 0.02 * Math.sign(event.deltaY);
    level();
  }, { passive: false });

  window.addEventListener("DOMContentLoaded", () => {
    element("style", document.head, CSS);
    document.body.append(panel, handle);
    draw();
    connect();
    setInterval(() => level(true), HEARTBEAT);
    setInterval(() => level(), HEARTBEAT / 4); // gamepads have no events
  });
})();
