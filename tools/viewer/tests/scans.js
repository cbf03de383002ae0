// Archives of generated scans, made once by this repository's programs and kept in the target folder.
//
// SLICEWALK_BIN is the folder of sliceconv, slicetool, scangen and replay; by default the newer build of the
// repository.

import { execFileSync } from "node:child_process";
import { existsSync, mkdirSync, readFileSync, renameSync, rmSync, statSync } from "node:fs";
import { basename, dirname, extname, join } from "node:path";
import { fileURLToPath } from "node:url";

const root = join(dirname(fileURLToPath(import.meta.url)), "../../..");
const target = process.env.CARGO_TARGET_DIR ?? join(root, "target");

function programs() {
  const folders = [process.env.SLICEWALK_BIN, join(target, "release"), join(target, "debug")].filter(Boolean);
  const built = folders.filter((folder) => existsSync(join(folder, "sliceconv")));
  const age = (folder) => statSync(join(folder, "sliceconv")).mtimeMs;
  const found = process.env.SLICEWALK_BIN ?? built.sort((a, b) => age(b) - age(a))[0];
  if (found === undefined) throw new Error("build the programs first: cargo build");
  return found;
}

export const DIST = process.env.SLICEWALK_PAGE ?? join(root, "tools/viewer/dist");
export const BIN = programs();
const kept = join(target, "viewer-tests");

export function program(name, ...args) {
  return execFileSync(join(BIN, name), args, { encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] });
}

/**
 * The archive `name`, made by `scangen` and `sliceconv` with these arguments from a scan of this kind, unless it
 * exists.
 */
function made(name, scene, conversion, kind = "laz") {
  const path = join(kept, `${name}.slices`);
  if (existsSync(path)) return path;
  mkdirSync(kept, { recursive: true });
  const scan = join(kept, `${name}-${process.pid}.${kind}`);
  const output = join(kept, `${name}-${process.pid}.slices`);
  try {
    program("scangen", ...scene, "-o", scan);
    program("sliceconv", scan, "-o", output, "--quiet", "--force", "--units", "m", ...conversion);
  } finally {
    rmSync(scan, { force: true });
  }
  renameSync(output, path);
  return path;
}

/** The house of the demonstration at 5 cm: doors of 1 m, storeys 3 m apart. */
export const house = () => made("house", ["demo"], ["--pixel", "0.05", "--exclude-class", "7"]);

/** The same house with colours by a formula, and with overview levels. */
export const colouredHouse = () =>
  made(
    "coloured",
    ["demo", "--format", "7", "--colour", "4"],
    ["--pixel", "0.05", "--exclude-class", "7", "--colour", "rgb", "--levels", "on"],
  );

/** That house with overview levels but without colours, to compare the cost of colours. */
export const levelledHouse = () =>
  made("levelled", ["demo", "--format", "7"], ["--pixel", "0.05", "--exclude-class", "7", "--levels", "on"]);

export const MOVED = [500_000, 5_000_000, 0];

/** The same house far from the origin: 1e6 is not a multiple of pixels or pages, so only the answers are the same. */
export const movedHouse = () =>
  made("moved", ["demo", "--origin", MOVED.join(",")], ["--pixel", "0.05", "--exclude-class", "7"]);

/** A shaft 150 m deep, from the highest storey. */
export const tower = () =>
  made(
    "tower",
    ["tower", "--param", "storeys=51", "--param", "size=6", "--order", "grid", "--density", "150"],
    ["--pixel", "0.2"],
  );

/** A street of 300 m with 20 kB per metre: more than a link delivers at once. */
export const street = () =>
  made("street", ["street", "--param", "length=300", "--density", "400", "--noise", "0.015"], ["--pixel", "0.05"]);

/** A coarser street with overview levels. */
export const avenue = () =>
  made(
    "avenue",
    ["street", "--param", "length=300", "--density", "60", "--noise", "0.015"],
    ["--pixel", "0.1", "--levels", "on"],
  );

/** The same street with colours by a formula; most of it lies beyond the pages that a view draws. */
export const colouredAvenue = () =>
  made(
    "coloured-avenue",
    ["street", "--param", "length=300", "--density", "60", "--noise", "0.015", "--format", "7", "--colour", "60"],
    ["--pixel", "0.1", "--levels", "on", "--colour", "rgb"],
  );

/**
 * A city of 896 × 427 × 789 m with pixels of 5 cm and overview levels: 160 points per square metre, 144 M in total.
 * Only for `bench.js`: it takes minutes, and 3 GB of disk while it is made.
 */
export const city = () =>
  made(
    "city",
    ["extent", "--density", "160", "--noise", "0.002", "--order", "grid"],
    ["--pixel", "0.05", "--levels", "on", "--memory", "1GiB"],
    "las",
  );

/** Byte range of an archive's colours: the first byte, and the first after them (specification, chapter 3). */
export function colourBytes(archive) {
  const { bytes } = JSON.parse(program("slicetool", "info", archive, "--json"));
  const head = readFileSync(archive).readUInt32LE(12);
  return [head + bytes.tiles, head + bytes.tiles + bytes.colours];
}

/** The real scan of two storeys at 5 cm, from the folder SLICEWALK_DATA. */
export function twoStoreys() {
  const path = join(kept, "indoor.slices");
  if (existsSync(path)) return path;
  const data = process.env.SLICEWALK_DATA;
  if (data === undefined) throw new Error("set SLICEWALK_DATA to the folder of indoor_two_storey_zup.laz");
  mkdirSync(kept, { recursive: true });
  program("sliceconv", join(data, "indoor_two_storey_zup.laz"), "-o", path, "--quiet", "--pixel", "0.05", "--levels", "on");
  return path;
}

/** A real scan of this name with its colours, from the folder SLICEWALK_DATA. */
export const scanned = (name, ...conversion) => scannedFile(`${name}.laz`, ...conversion);

/** A real scan in this file of that folder. */
export function scannedFile(file, ...conversion) {
  const name = basename(file, extname(file));
  const path = join(kept, `${name}.slices`);
  if (existsSync(path)) return path;
  const data = process.env.SLICEWALK_DATA;
  if (data === undefined) throw new Error(`set SLICEWALK_DATA to the folder of ${file}`);
  mkdirSync(kept, { recursive: true });
  program("sliceconv", join(data, file), "-o", path, "--quiet", "--colour", "auto", ...conversion);
  return path;
}

/** A room with its floor at 0 and without a table: another archive for the same name. */
export const other = () => made("other", ["house", "--param", "storeys=1", "--density", "400"], ["--pixel", "0.05"]);

/** Route up the stairs of the house: places to walk straight to, in turn. */
export const WAY = {
  start: [1.5, 2, 0],
  places: [
    [3.8, 5],
    [6.4, 5],
    [11, 1.1],
    [13.45, 1.1],
    [13.45, 7.3],
  ],
};
