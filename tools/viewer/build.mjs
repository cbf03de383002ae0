// Builds the viewer: the engine and the conversion as wasm, their package (tools/viewer/package/dist) and the page
// (tools/viewer/dist). On every platform:
//
//   node tools/viewer/build.mjs            all of it
//   node tools/viewer/build.mjs --engine   without the page
//
// Needs Rust and Node.js 20.19 or newer with npm, and nothing else. The Rust target wasm32-unknown-unknown is added by rustup
// if it is not installed; where there is no rustup, or it cannot download, `toolchain.sh` unpacks a compiler on Debian.
// CARGO_TARGET_DIR is respected.

import { execFileSync, spawn, spawnSync } from "node:child_process";
import { once } from "node:events";
import { copyFileSync, existsSync, mkdirSync, readdirSync, readFileSync, rmSync } from "node:fs";
import { homedir } from "node:os";
import { dirname, join, resolve, sep } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";

const TARGET = "wasm32-unknown-unknown";
const FLAGS = "CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS";
const viewer = dirname(fileURLToPath(import.meta.url));
const root = join(viewer, "../..");
const target = process.env.CARGO_TARGET_DIR ?? join(root, "target");
const isWindows = process.platform === "win32";

function fail(text) {
  console.error(`build.mjs: ${text}`);
  process.exit(1);
}

// Programs that run beside one that fails end with it.
const running = new Set();
process.on("exit", () => running.forEach((child) => child.kill()));

/** Runs a program in a folder; its failure is the end. */
async function run(folder, program, words, variables = {}) {
  // npm is a script of the shell on Windows.
  const shell = isWindows && program === "npm";
  const child = spawn(program, words, { cwd: folder, stdio: "inherit", shell, env: { ...process.env, ...variables } });
  running.add(child);
  const [status] = await once(child, "close").catch((error) => fail(`${program} cannot be started: ${error.message}`));
  running.delete(child);
  if (status !== 0) fail(`${program} ${words.slice(0, 4).join(" ")} failed`);
}

function answer(program, words) {
  const done = spawnSync(program, words, { cwd: root, encoding: "utf8" });
  return done.status === 0 ? done.stdout.trim() : null;
}

/** Variables and words for cargo. */
function toolchain() {
  const hasTarget = () => {
    const folder = answer("rustc", ["--print", "target-libdir", "--target", TARGET]);
    return folder !== null && existsSync(folder);
  };
  if (hasTarget()) return { variables: {}, words: [] };
  if (answer("rustup", ["target", "add", TARGET]) !== null && hasTarget()) return { variables: {}, words: [] };
  const folder = process.env.SLICEWALK_WASM_TOOLCHAIN ?? join(target, "wasm-toolchain");
  const found = spawnSync("bash", [join(viewer, "toolchain.sh"), folder], {
    encoding: "utf8",
    stdio: ["ignore", "pipe", "inherit"],
  });
  if (found.status !== 0) fail(`the Rust target ${TARGET} is not installed; run: rustup target add ${TARGET}`);
  // The script prints lines for a shell, which resolves the variables in them.
  const script = `${found.stdout}\nenv -0`;
  const variables = Object.fromEntries(
    execFileSync("bash", ["-c", script], { encoding: "utf8" })
      .split("\0")
      .filter(Boolean)
      .map((line) => [line.slice(0, line.indexOf("=")), line.slice(line.indexOf("=") + 1)]),
  );
  return { variables, words: (variables.WASM_FLAGS ?? "").split(" ").filter(Boolean) };
}

/** Adds the compiler's flags by which modules do not name folders of this machine: the same sources give the same bytes everywhere. */
async function nameless(variables) {
  const fetch = ["fetch", "--quiet", "--target", TARGET];
  await run(root, "cargo", fetch, variables);
  await run(join(viewer, "convert"), "cargo", fetch, variables);
  const sources = join(process.env.CARGO_HOME ?? join(homedir(), ".cargo"), "registry/src");
  // The conversion is no part of the workspace, so crates of the workspace have whole paths in it.
  const folders = [...readdirSync(sources).map((name) => join(sources, name)), resolve(root)].map((name) => name + sep);
  const flags = [variables[FLAGS] ?? process.env[FLAGS] ?? "", ...folders.map((folder) => `--remap-path-prefix=${folder}=`)];
  return { ...variables, [FLAGS]: flags.join(" ").trim() };
}

async function npmPackage(name) {
  await run(join(viewer, name), "npm", ["ci", "--no-audit", "--no-fund", "--loglevel=error"]);
  if (name !== "bindgen") await run(join(viewer, name), "npm", ["run", "--silent", "build"]);
}

/** Removes what the compiler leaves: duplicate functions, unused parameters and stores. Passes that shrink a module by renaming
 * and reordering locals (-Os, -Oz) make the compressed form of the engine larger, and that of the conversion smaller. */
const PASSES = {
  "convert.wasm": ["-Oz", "--vacuum"],
  "engine_bg.wasm": [
    ["-O1", "--rse", "--vacuum", "--dae-optimizing", "--simplify-locals-nonesting", "--code-folding"],
    ["--duplicate-function-elimination", "--generate-global-effects", "--vacuum", "--simplify-globals"],
    ["--remove-unused-module-elements"],
  ].flat(),
};

async function shrink(name) {
  const path = join(wasm, name);
  const program = join(viewer, "bindgen/node_modules/binaryen/bin/wasm-opt");
  const features = [
    "--enable-bulk-memory",
    "--enable-nontrapping-float-to-int",
    "--enable-sign-ext",
    "--enable-mutable-globals",
  ];
  await run(root, process.execPath, [program, ...features, ...PASSES[name], path, "-o", path]);
}

const [major, minor] = process.versions.node.split(".").map(Number);
if (major < 20 || (major === 20 && minor < 19)) fail(`Node.js ${process.versions.node} is too old; install 20.19 or newer`);
if (answer("cargo", ["--version"]) === null) fail("cargo is not installed; https://rustup.rs has it");

const { variables: found, words } = toolchain();
const variables = await nameless(found);
const wasm = join(viewer, "package/src/wasm");
const builds = join(target, "wasm");
const engine = ["build", "--quiet", "-p", "slicewalk-engine", "--lib", "--profile", "wasm", "--target", TARGET];
const convert = ["build", "--quiet", "--release", "--target", TARGET, "--target-dir", join(target, "wasm-convert")];
const bindgen = ["build", "--quiet", "--target-dir", join(target, "viewer-bindgen")];
// Both modules are linked on one core each.
await Promise.all([
  run(root, "cargo", [...engine, "--target-dir", builds, ...words], variables),
  run(join(viewer, "convert"), "cargo", [...convert, ...words], variables),
  run(join(viewer, "bindgen"), "cargo", bindgen, { CARGO_PROFILE_DEV_DEBUG: "0" }),
  npmPackage("bindgen"),
]);
rmSync(wasm, { recursive: true, force: true });
mkdirSync(wasm, { recursive: true });
await run(root, join(target, `viewer-bindgen/debug/viewer-bindgen${isWindows ? ".exe" : ""}`), [
  join(builds, TARGET, "wasm/slicewalk_engine.wasm"),
  wasm,
]);
copyFileSync(join(target, "wasm-convert", TARGET, "release/viewer_convert.wasm"), join(wasm, "convert.wasm"));
const modules = ["engine_bg.wasm", "convert.wasm"];
await Promise.all(modules.map(shrink));
for (const name of modules) {
  console.log(`${name}: ${gzipSync(readFileSync(join(wasm, name)), { level: 9 }).length} bytes compressed`);
}
await npmPackage("package");
if (!process.argv.includes("--engine")) await npmPackage("page");
