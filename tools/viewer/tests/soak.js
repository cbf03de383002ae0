// The whole system for hours: `slicetool serve`, a page that walks at random, and, if SLICEWALK_PYTHON names an interpreter
// with the package, streams from that server in Python. `node soak.js [HOURS]`, or `.ci/long live`.
//
// Once a minute it notes memory, threads and open files of each program, and the page's heap, and writes them to
// `soak.csv` beside the archives that the tests keep. It fails when one of them is higher in the last third of the time
// than in the second by more than noise. The first third warms up.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { launch, state, until } from "./browser.js";
import { BIN, DIST, house, street, tower } from "./scans.js";

const HOURS = Number(process.argv[2] ?? 8);
const SAMPLE_MS = Math.min(60_000, (HOURS * 3_600_000) / 60);
/** Time that the page stays in an archive, and holds its keys. */
const STAY_MS = 120_000;
const MOST_HELD_MS = 6_000;
/** What may come and go: a share of memory, and memory (MiB) and threads or files as such. */
const NOISE = { share: 1.1, mib: 16, count: 3 };
const KEYS = ["w", "a", "s", "d", " ", "Shift", "c", "f", "o", "p"];
const STREAM = join(import.meta.dirname, "../../python/tests/soak.py");

const any = (list) => list[Math.floor(Math.random() * list.length)];
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

/** Memory (MiB), threads and open files of a process. */
function measured(pid) {
  const status = readFileSync(`/proc/${pid}/status`, "utf8");
  const field = (name) => Number(status.match(new RegExp(`^${name}:\\s*(\\d+)`, "m"))?.[1]);
  return { mib: field("VmRSS") / 1024, threads: field("Threads"), files: readdirSync(`/proc/${pid}/fd`).length };
}

/** Memory, threads and files of all processes of a browser, its page's heap (MiB) and its number of nodes. */
async function ofBrowser(pid, metrics) {
  const parents = readdirSync("/proc")
    .filter((name) => /^\d+$/.test(name))
    .map((name) => {
      try {
        return [Number(name), Number(readFileSync(`/proc/${name}/stat`, "utf8").split(") ").at(-1).split(" ")[1])];
      } catch {
        return [Number(name), 0]; // it has ended
      }
    });
  const family = new Set([pid]);
  for (let grown = true; grown;) {
    const before = family.size;
    for (const [child, parent] of parents) if (family.has(parent)) family.add(child);
    grown = family.size > before;
  }
  const sum = { mib: 0, threads: 0, files: 0 };
  for (const member of family) {
    try {
      const one = measured(member);
      for (const what of Object.keys(sum)) sum[what] += one[what];
    } catch {
      // It has ended.
    }
  }
  return { ...sum, ...(await metrics()) };
}

/** A program that ends with the soak, and whose first line on standard output may be awaited. */
function begin(command, ...args) {
  const child = spawn(command, args, { stdio: ["ignore", "pipe", "inherit"] });
  let text = "";
  const line = new Promise((resolve, reject) => {
    child.stdout.on("data", (more) => {
      text += more;
      const found = text.match(/http:\/\/\S+/);
      if (found) resolve(found[0]);
    });
    child.on("exit", (code) => reject(new Error(`${command} ended with ${code}: ${text}`)));
  });
  line.catch(() => {}); // some are never asked
  return { child, line, says: () => text };
}

/** Walks, flies, looks from outside and opens other archives until `end`. */
async function wander(page, address, names, end) {
  const counts = { archives: 0, places: 0, keys: 0 };
  while (Date.now() < end) {
    const name = any(names);
    await page.goto(`${address}?archive=${name}`);
    await until(page, `open ${name}`, ({ ready, error }) => ready && error === null, { timeout: 120_000 });
    counts.archives++;
    const leave = Math.min(end, Date.now() + STAY_MS);
    while (Date.now() < leave) {
      const { at } = await state(page);
      const [dx, dy] = [0, 0].map(() => (Math.random() - 0.5) * 20);
      const look = [Math.random() * 360 - 180, Math.random() * 60 - 40];
      if (Math.random() < 0.3) {
        await page.evaluate((place) => window.slicewalk.goto(place), { at: [at[0] + dx, at[1] + dy, 3], look });
        counts.places++;
      }
      const key = any(KEYS);
      await page.keyboard.down(key);
      await pause(Math.random() * MOST_HELD_MS);
      await page.keyboard.up(key);
      counts.keys++;
    }
  }
  return counts;
}

/** Whether a figure is higher in the last third than in the second. */
function growth(rows, who, what) {
  const values = rows.map((row) => row[who][what]);
  const third = Math.floor(values.length / 3);
  const median = (part) => part.toSorted((a, b) => a - b)[Math.floor(part.length / 2)];
  const [before, after] = [median(values.slice(third, 2 * third)), median(values.slice(2 * third))];
  const isMemory = what.endsWith("mib") || what === "heap";
  const most = isMemory ? Math.max(before * NOISE.share, before + NOISE.mib) : before * NOISE.share + NOISE.count;
  const words = `${who} ${what}: ${before.toFixed(1)} in the second third, ${after.toFixed(1)} in the last`;
  return { words, held: after <= most };
}

const archives = [house(), street(), tower()];
const serve = begin(join(BIN, "slicetool"), "serve", "--page", DIST, ...archives);
const address = (await serve.line).split("?")[0];
const names = archives.map((path) => path.split("/").at(-1));
const end = Date.now() + HOURS * 3_600_000;
const python = process.env.SLICEWALK_PYTHON;
const streams =
  python === undefined
    ? null
    : begin(python, STREAM, String(HOURS * 3600), ...names.map((name) => new URL(name, address).href));
const browser = await launch();
const page = await browser.newPage();
const session = await page.context().newCDPSession(page);
await session.send("Performance.enable");
const metrics = async () => {
  const { metrics } = await session.send("Performance.getMetrics");
  const of = (name) => metrics.find((metric) => metric.name === name)?.value ?? NaN;
  return { heap: of("JSHeapUsedSize") / (1 << 20), nodes: of("Nodes") };
};

const rows = [];
const sampling = setInterval(async () => {
  try {
    const row = { serve: measured(serve.child.pid), browser: await ofBrowser(browser.pid, metrics) };
    if (streams !== null) row.python = measured(streams.child.pid);
    rows.push(row);
  } catch (error) {
    console.error(`a sample failed: ${error}`);
  }
}, SAMPLE_MS);
let counts;
try {
  counts = await wander(page, address, names, end - SAMPLE_MS);
} finally {
  clearInterval(sampling);
  await browser.close();
  serve.child.kill("SIGINT");
  streams?.child.kill("SIGINT");
}

const heads = Object.keys(rows[0]).flatMap((who) => Object.keys(rows[0][who]).map((what) => [who, what]));
const lines = [
  heads.map((head) => head.join(" ")),
  ...rows.map((row) => heads.map(([who, what]) => row[who][what].toFixed(1))),
];
const csv = join(dirname(archives[0]), "soak.csv");
writeFileSync(csv, lines.map((line) => line.join(",")).join("\n") + "\n");
console.log(`${HOURS} h, ${rows.length} samples in ${csv}`);
console.log(`page: ${counts.archives} archives opened, ${counts.places} places, ${counts.keys} keys held`);
if (streams !== null) console.log(`Python: ${streams.says().trim().split("\n").at(-1)}`);
for (const [who, what] of heads) {
  const { words, held } = growth(rows, who, what);
  console.log(`${held ? "ok  " : "OVER"}  ${words}`);
  if (!held) process.exitCode = 1;
}
assert.deepEqual(page.complaints, []);
