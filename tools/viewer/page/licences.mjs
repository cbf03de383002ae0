// Writes dist/licences.txt with the licences of every part of the built page. Run after `vite build`.

import { execFileSync } from "node:child_process";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const root = join(here, "../../..");
const json = (path) => JSON.parse(readFileSync(path, "utf8"));
const own = (name) => readFileSync(join(root, name), "utf8").trim();

/** Licence texts in `folder`; if there are none, the usual text of the licence. */
function texts(folder, licence, author) {
  const names = readdirSync(folder, { withFileTypes: true }).filter(
    (entry) => entry.isFile() && /^(licen[cs]e|copying|notice)/i.test(entry.name),
  );
  if (names.length > 0) return names.map(({ name }) => readFileSync(join(folder, name), "utf8").trim()).sort();
  if (/Apache-2\.0/.test(licence)) return [own("LICENSE-APACHE")];
  return [`Copyright (c) ${author}\n\n${own("LICENSE-MIT").replace(/^[\s\S]*?(?=Permission is hereby granted)/, "")}`];
}

const parts = [];

// Includes the packages bundled by these dependencies.
for (const name of [...Object.keys(json(join(here, "package.json")).dependencies), "laz-perf", "fflate"]) {
  if (name === "slicewalk" || parts.some((part) => part.name.startsWith(`${name} `))) continue;
  const folder = join(here, "node_modules", name);
  const { version, license, author } = json(join(folder, "package.json"));
  const who = typeof author === "string" ? author : (author?.name ?? `the authors of ${name}`);
  parts.push({ name: `${name} ${version}`, licence: license, texts: texts(folder, license, who) });
}

const cargo = (...args) => execFileSync("cargo", args, { cwd: root, encoding: "utf8", maxBuffer: 1 << 28 });
const crates = new Map(
  JSON.parse(cargo("metadata", "--format-version", "1")).packages.map((crate) => [`${crate.name} ${crate.version}`, crate]),
);
const tree = ["-p", "slicewalk-engine", "--target", "wasm32-unknown-unknown", "--edges", "no-dev,no-build,no-proc-macro"];
for (const line of new Set(cargo("tree", ...tree, "--prefix", "none", "--format", "{p}").split("\n"))) {
  const [name, version] = line.split(" ");
  const crate = crates.get(`${name} ${version?.slice(1)}`);
  if (!crate?.source || parts.some((part) => part.name === `${name} ${crate.version}`)) continue;
  const folder = dirname(crate.manifest_path);
  parts.push({
    name: `${name} ${crate.version}`,
    licence: crate.license,
    texts: texts(folder, crate.license, crate.authors.join(", ") || `the authors of ${name}`),
  });
}

// A text shared by several parts appears once.
const users = new Map();
for (const part of parts) for (const text of part.texts) users.set(text, [...(users.get(text) ?? []), part.name]);
const list = parts
  .map(({ name, licence }) => `  ${name}: ${licence}`)
  .sort()
  .join("\n");
const bodies = [...users].map(([text, names]) => `${"-".repeat(100)}\n${names.join(", ")}\n\n${text}`);
const head = "Slicewalk is licensed under MIT or Apache-2.0, at your choice. This page contains the following software.";
writeFileSync(join(here, "../dist/licences.txt"), `${head}\n\n${list}\n\n${bodies.join("\n\n")}\n`);
console.log(`licences.txt: ${parts.length} parts`);
