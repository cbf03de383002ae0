// Writes dist/licences.txt: the licences of everything that is part of the built page. Run after `vite build`.

import { execFileSync } from "node:child_process";
import { existsSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const parts = new Map();

/** The texts of licences in `folder`. */
function licences(folder) {
  const names = readdirSync(folder).filter((name) => /^(licen[cs]e|copying|notice)/i.test(name)).sort();
  return names.map((name) => join(folder, name)).flatMap((path) => {
    try {
      return [readFileSync(path, "utf8").trim()];
    } catch {
      return []; // a folder of texts that other files repeat
    }
  });
}

const lock = JSON.parse(readFileSync(join(here, "package-lock.json"), "utf8"));
for (const [path, entry] of Object.entries(lock.packages)) {
  if (!path.startsWith("node_modules/") || entry.dev || entry.link) continue;
  const folder = join(here, path);
  parts.set(`${path.slice("node_modules/".length)} ${entry.version} (${entry.license})`, licences(folder));
}

const engine = join(here, "../engine/Cargo.toml");
if (existsSync(engine)) {
  const wasm = ["--filter-platform", "wasm32-unknown-unknown"];
  const output = execFileSync("cargo", ["metadata", "--format-version", "1", "--manifest-path", engine, ...wasm], { maxBuffer: 1 << 28 });
  const metadata = JSON.parse(output);
  const packages = new Map(metadata.packages.map((entry) => [entry.id, entry]));
  const nodes = new Map(metadata.resolve.nodes.map((node) => [node.id, node]));
  const seen = new Set();
  const visit = (id) => {
    if (seen.has(id)) return;
    seen.add(id);
    const built = nodes.get(id).deps.filter((dep) => dep.dep_kinds.some((kind) => kind.kind === null));
    built.map((dep) => dep.pkg).forEach(visit);
  };
  visit(metadata.packages.find((entry) => entry.manifest_path === engine).id);
  for (const entry of [...seen].map((id) => packages.get(id)).filter((entry) => entry.source !== null)) {
    parts.set(`${entry.name} ${entry.version} (${entry.license})`, licences(dirname(entry.manifest_path)));
  }
}

const missing = [...parts].filter(([, texts]) => texts.length === 0).map(([name]) => name);
const sections = [...parts].sort(([a], [b]) => (a < b ? -1 : 1)).map(([name, texts]) => [name, "=".repeat(name.length), ...texts].join("\n\n"));
const head = "Slicewalk is licensed under MIT or Apache-2.0, at your choice. It contains the following software.";
writeFileSync(join(here, "../dist/licences.txt"), `${[head, ...sections].join("\n\n\n")}\n`);
console.log(`licences.txt: ${parts.size} parts${missing.length > 0 ? `; without a text of their own: ${missing.join(", ")}` : ""}`);
