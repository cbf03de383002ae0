// The conversion module against sliceconv, byte for byte: generated scans, and real ones of the folder SLICEWALK_DATA.
//
// SLICEWALK_BIN is the folder of sliceconv and scangen.

import assert from "node:assert/strict";
import { execFileSync, spawnSync } from "node:child_process";
import { existsSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { after, before, test } from "node:test";
import { BlobFile } from "../dist/convert/files.js";
import { CHANGED, isOutOfMemory, runConversion } from "../dist/convert/module.js";
import { FileHost } from "./files.js";

const root = new URL("../../../../", import.meta.url).pathname;
const programs = process.env.SLICEWALK_BIN ?? join(root, "target/debug");
const data = process.env.SLICEWALK_DATA;
const folder = mkdtempSync(join(tmpdir(), "convert-"));
let module;
before(async () => {
  module = await WebAssembly.compile(readFileSync(new URL("../dist/wasm/convert.wasm", import.meta.url)));
});
after(() => rmSync(folder, { recursive: true, force: true }));

async function convert(paths, options = {}, task = "convert") {
  const host = new FileHost(paths, join(folder, "temporary"));
  try {
    const answer = await runConversion(module, host, { task, inputs: host.inputs, options });
    return { answer, host, archive: answer.file === undefined ? null : host.bytes(answer.file, answer.length) };
  } finally {
    host.close();
  }
}

/** Arguments of sliceconv for options as in Python. */
const words = (options) =>
  Object.entries(options).flatMap(([name, value]) => {
    const option = `--${name.replaceAll("_", "-")}`;
    if (name === "levels") return [option, value ? "on" : "off"];
    if (name === "scale_from") return [option, ...value.map(String)];
    return value === true ? [option] : [option, String(value)];
  });

function natively(paths, options) {
  const output = join(folder, "native.slices");
  rmSync(output, { force: true });
  const run = spawnSync(join(programs, "sliceconv"), [...paths, "-o", output, "--json", ...words(options)], {
    encoding: "utf8",
  });
  return { error: run.status === 0 ? null : run.stderr, archive: run.status === 0 ? readFileSync(output) : null };
}

/** Both convert to the same bytes, or both refuse the input. */
async function agree(paths, options = {}) {
  const { error, archive } = natively(paths, options);
  const here = await convert(paths, options);
  const name = `${paths.map((path) => basename(path)).join(", ")} ${JSON.stringify(options)}`;
  if (error !== null) {
    assert.ok(here.answer.error, `${name}: sliceconv refuses it: ${error}`);
    return false;
  }
  assert.equal(here.answer.error, undefined, `${name}: ${here.answer.error}`);
  assert.ok(Buffer.from(here.archive).equals(archive), `${name}: ${here.archive.length} bytes, natively ${archive.length}`);
  return true;
}

function scan(name, ...scene) {
  const path = join(folder, name);
  execFileSync(join(programs, "scangen"), [...scene, "-o", path], { stdio: "pipe" });
  return path;
}

test("generated scans, with each kind of option", async () => {
  const laz = scan("house.laz", "demo", "--format", "7", "--colour", "4");
  for (const options of [
    { pixel: 0.1, units: "m" },
    { pixel: "auto", units: "m", colour: "auto", levels: true },
    { pixel: 0.1, units: "m", tolerance: "auto", exclude_class: "7,18", fill_holes: 0.3 },
    { pixel: 0.15, slice: 0.3, units: "m", classifier: "span", min_points: 2, drop_isolated: true, up: "y" },
    { pixel: 0.1, units: "ft", crs: "EPSG:25832", classifier: "thesis", drop_floaters: 4, max_slope: 30 },
    { pixel: 0.1, scale_from: [[0, 0, 0], [2, 0, 0], 1] },
  ]) {
    assert.ok(await agree([laz], options));
  }
  assert.ok(await agree([scan("house.las", "demo")], { pixel: 0.1, units: "m", colour: "class" }));
});

test("files of the same name are all read, unless they lie beside a mesh", async () => {
  const tile = (name, x) => {
    mkdirSync(join(folder, name), { recursive: true });
    const path = join(folder, name, "tile.xyz");
    writeFileSync(path, Array.from({ length: 100 }, (_, n) => `${x + n / 10} 0 0\n`).join(""));
    return path;
  };
  const paths = [tile("north", 0), tile("south", 50), tile("west", -50)];
  const options = { pixel: 0.5, units: "m" };
  assert.ok(await agree(paths, options));
  const host = new FileHost([...paths, paths[0]], join(folder, "temporary"));
  const inputs = host.inputs.map((input, n) => (n < 3 ? input : { ...input, name: "wall.mtl", beside: true }));
  const answer = await runConversion(module, host, { task: "preview", inputs, options });
  host.close();
  assert.match(answer.error, /^inputs: two files are called tile\.xyz;/);
});

test("seen space of scans that state their stations", async () => {
  const path = join(folder, "wall.ptx");
  // A wall 4 m ahead of two stations.
  const cloud = ([a, b, c]) => {
    const places = Array.from({ length: 2000 }, (_, n) => [(n % 50) * 0.1 - 1 - a, 4 - b, Math.floor(n / 50) * 0.08 - c]);
    const rows = places.map((place) => `${place.map((v) => v.toFixed(3)).join(" ")} 0.5\n`);
    const pose = `${a} ${b} ${c}\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n${a} ${b} ${c} 1`;
    return `${rows.length}\n1\n${pose}\n${rows.join("")}`;
  };
  writeFileSync(path, cloud([0, 0, 1.5]) + cloud([3, 1, 1.5]));
  const options = { pixel: 0.1, free_space: true };
  assert.ok(await agree([path], options));
  assert.ok((await convert([path], options)).answer.report.seen.cells > 0);
});

test("data that memory cannot hold is spilled, and the bytes stay the same", async () => {
  const path = scan("large.las", "house", "--density", "30000");
  const options = { pixel: 0.05, units: "m", colour: "intensity" };
  const whole = await convert([path], options);
  const spilled = await convert([path], { ...options, memory: "64MiB" });
  assert.ok(spilled.host.written > 2 * whole.archive.length, `${spilled.host.written} bytes written`);
  assert.ok(Buffer.from(spilled.archive).equals(Buffer.from(whole.archive)));
  assert.ok(Buffer.from(whole.archive).equals(natively([path], options).archive));
});

test("a preview says what the file is", async () => {
  const { answer } = await convert([join(folder, "house.laz")], { units: "m" }, "preview");
  const stated = execFileSync(join(programs, "sliceconv"), [join(folder, "house.laz"), "--dry-run", "--json", "--units", "m"], {
    encoding: "utf8",
  });
  const native = JSON.parse(stated);
  for (const key of ["points_stated", "bounds", "extent", "crs", "unit", "input_bytes"]) {
    assert.deepEqual(answer.preview[key], native[key], key);
  }
});

test("what cannot be converted is said in one line", async () => {
  const wrong = join(folder, "wrong.laz");
  writeFileSync(wrong, "no scan at all");
  const bytes = readFileSync(join(folder, "house.laz"));
  const cut = join(folder, "cut.laz");
  writeFileSync(cut, bytes.subarray(0, bytes.length / 2));
  for (const [path, options, expected] of [
    [wrong, {}, /wrong\.laz/],
    [cut, { units: "m" }, /cut\.laz/],
    [join(folder, "house.laz"), { pixel: -1 }, /pixel/],
    [join(folder, "house.laz"), { colours: "rgb" }, /colours/],
    [join(folder, "house.laz"), { drop_isolated: true, drop_floaters: 5 }, /^drop_isolated: .*leave one of them out/],
    [join(folder, "house.laz"), { units: "m", scale_from: [[0, 0, 0], [2, 0, 0], 1] }, /^scale_from: .*leave one of them out/],
    [join(folder, "house.laz"), { scale_from: [0, 2, 1] }, /^scale_from: expected two places/],
    [join(folder, "house.laz"), { scale_from: [[0, 0, 0], [0, 0, 0], 1] }, /^scale_from: the two places are the same/],
  ]) {
    const { answer } = await convert([path], options);
    assert.match(answer.error, expected);
    assert.equal(answer.error.includes("\n"), false);
  }
});

test("only exhausted memory counts as out of memory", () => {
  const { RuntimeError } = WebAssembly;
  for (const error of [new RangeError("Array buffer allocation failed"), new Error("Out of memory: cannot allocate")]) {
    assert.ok(isOutOfMemory(error), `${error}`);
  }
  for (const error of [new RuntimeError("memory access out of bounds"), new RuntimeError("unreachable")]) {
    assert.ok(!isOutOfMemory(error), `${error}`);
  }
});

test("a full disk and a file that changes end in an error", async () => {
  const path = join(folder, "house.laz");
  for (const [fault, expected] of [
    [{ room: 10_000 }, /space/],
    [{ changed: 100_000 }, /changed/],
  ]) {
    const host = new FileHost([path], join(folder, "temporary"), fault);
    const options = { pixel: 0.1, units: "m" };
    const answer = await runConversion(module, host, { task: "convert", inputs: host.inputs, options });
    host.close();
    assert.match(answer.error, expected);
  }
});

test("real scans and meshes of every format", { skip: data === undefined && "SLICEWALK_DATA is not set" }, async (t) => {
  const endings = /\.(las|laz|e57|ptx|pts|xyz|txt|csv|pcd|ply|obj|stl|gltf|glb|spz|sog|splat|ksplat|zst|gz)$/i;
  const most = Number(process.env.SLICEWALK_CONVERT_MOST ?? 12_000_000);
  let same = 0;
  for (const below of ["", "odd", "meshes", "formats"]) {
    const at = join(data, below);
    if (!existsSync(at)) continue;
    for (const name of readdirSync(at, { recursive: below === "formats" }).sort()) {
      const path = join(at, name);
      if (!endings.test(name) || !statSync(path).isFile() || statSync(path).size > most) continue;
      // Files that name others lie in a folder that the module does not see.
      if (/\.gltf$/i.test(name)) continue;
      const options = { units: "m", colour: "auto", pixel: /odd|formats/.test(below) ? 0.5 : "auto" };
      if (await agree([path], options)) same += 1;
    }
  }
  t.diagnostic(`${same} files give the same bytes`);
  assert.ok(same > 40, `${same}`);
});

test("files are read in blocks as they are, and a cut one is noticed", async () => {
  const content = Uint8Array.from({ length: (3 << 20) + 12_345 }, (_, n) => (n * 2654435761) >>> 13);
  const slice = (bytes) => ({
    size: bytes.length,
    slice: (from, to) => slice(bytes.subarray(from, to)),
    arrayBuffer: async () => bytes.slice().buffer,
    now: () => bytes.slice().buffer,
  });
  globalThis.FileReaderSync = class {
    readAsArrayBuffer(blob) {
      return blob.now();
    }
  };
  const file = new BlobFile(slice(content));
  for (const [at, length] of [
    [0, 10],
    [(1 << 20) - 3, 7],
    [5, 1 << 20],
    [2 << 20, 1 << 20],
    [content.length - 5, 100],
    [content.length, 4],
    [1 << 20, 1],
  ]) {
    const into = new Uint8Array(length);
    const read = await file.read(at, into);
    assert.equal(read, Math.min(length, content.length - at), `at ${at}`);
    assert.deepEqual(into.subarray(0, read), content.subarray(at, at + read), `at ${at}`);
  }
  const cut = slice(content);
  cut.slice = (from, to) => ({
    ...slice(content.subarray(from, to)),
    now: () => new ArrayBuffer(9),
    arrayBuffer: async () => new ArrayBuffer(9),
  });
  assert.equal(await new BlobFile(cut).read(0, new Uint8Array(4)), CHANGED);
});
