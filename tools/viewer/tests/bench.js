// Benchmark of the viewer: limits and measured values. Run it by hand on a quiet machine: `.ci/long viewer`, or
// `node bench.js [PART...]` with the parts native, street, house, city, colours and drop.
//
// SLICEWALK_ENGINE_CHECK is the output folder of an optimised `record`, which contains the native times. SLICEWALK_BIN
// is a folder of optimised programs, which make the city in a few minutes.

import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { launch, until, walkIn } from "./browser.js";
import { city, colouredHouse, DIST, house, levelledHouse, program, scanned, street, WAY } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { address, firstStep, LINK, runAlong, settled, walkTowards, watch, watched } from "./steer.js";

/**
 * Limit relative to the native time. A frame is a message to a worker and back, whose time depends on browser and
 * machine; it may take this much longer (µs) than one to a worker that only computes for this multiple of the native
 * time.
 */
const MOST = 2;
const PASSING_US = 50;
/**
 * Limits: a task of the main thread while walking (ms), pages in memory (bytes), and bytes until a city's outline is
 * drawn.
 */
const TASK_MS = 50;
const PAGES_BYTES = 64 << 20;
const OUTLINE_BYTES = 3_000_000;

/** Points of scans that are dropped on the page, and the time until one can walk in them (s). */
const DROPS = [
  [1_000_000, 5],
  [10_000_000, 15],
];

const STREET_M = 100;
/** Start in a street of the city, and the distance walked. */
const CITY_START = [300, 240, 0.1];
const CITY_M = 60;
/** Number of alternating runs with and without colours. */
const TURNS = 3;
/** At screen size, software graphics take nearly all of a frame; with fewer pixels, the page's own work decides. */
const CANVASES = [
  { width: 800, height: 500 },
  { width: 160, height: 100 },
];

/** Prints a value beside its limit. */
function report(part, what, figure, most, unit) {
  const held = figure <= most;
  const digits = Number.isInteger(figure) && Number.isInteger(most) ? 0 : 1;
  const words = `${figure.toFixed(digits)} ${unit} (at most ${most.toFixed(digits)})`;
  console.log(`${held ? "ok  " : "OVER"}  ${part}: ${what}: ${words}`);
  if (!held) process.exitCode = 1;
}

/** Reports the watched values of a walk over the link. */
function reportWalk(part, { frames, missed, waited, bytes, tasks }) {
  if (frames === 0) throw new Error(`${part}: no frame was drawn`);
  report(part, `frames that missed a page, of ${frames} (${waited} pages in the worst)`, missed, 0, "frames");
  report(part, "most pages in memory", bytes / (1 << 20), PAGES_BYTES / (1 << 20), "MiB");
  reportTasks(part, tasks);
}

/** Browsers report only tasks of 50 ms and longer. */
function reportTasks(part, tasks) {
  const long = tasks.toSorted((a, b) => b - a).slice(0, 5);
  const words = long.length === 0 ? "none of 50 ms" : long.map((ms) => ms.toFixed(0)).join(", ");
  report(part, `longest task of the main thread (${tasks.length} long ones: ${words})`, long[0] ?? 0, TASK_MS, "ms");
}

/** Runs `work` in a new page with a server of these files. */
async function within(folder, files, work) {
  const server = await new StaticServer(folder, files).start();
  const browser = await launch();
  try {
    const page = await browser.newPage();
    await work(page, server).finally(() => page.end());
    if (page.complaints.length > 0) throw new Error(page.complaints.join("\n"));
  } finally {
    await browser.close();
    await server.stop();
  }
}

const parts = {
  /** LAZ files of a house: until the first step, conversion included; then the tasks of the page while it converts. */
  async drop() {
    const folder = mkdtempSync(join(tmpdir(), "drop-"));
    try {
      for (const [points, most] of DROPS) {
        const scan = join(folder, `${points}.laz`);
        program("scangen", "house", "--points", String(points), "--noise", "0.003", "--format", "7", "-o", scan);
        await within(DIST, {}, async (page, server) => {
          await page.goto(server.address);
          await page.waitForFunction(() => window.slicewalk !== undefined);
          await page.evaluate(() => {
            // What happens once somebody has answered the form.
            const input = document.querySelector("#open-file");
            input.addEventListener("change", (event) => event.stopImmediatePropagation(), { capture: true });
          });
          await page.locator("#open-file").setInputFiles(scan);
          const [seconds, tasks] = await page.evaluate(async () => {
            const [file] = document.querySelector("#open-file").files;
            const [begun, tasks] = [performance.now(), []];
            // Afterwards shaders are compiled, once.
            const converts = () => window.slicewalk.state().converting !== null;
            const note = (list) => converts() && tasks.push(...list.getEntries().map(({ duration }) => duration));
            new PerformanceObserver(note).observe({ type: "longtask" });
            await window.slicewalk.open(file, { units: "m" });
            return [(performance.now() - begun) / 1000, tasks];
          });
          report("drop", `${points / 1e6} M points of LAZ until the first step`, seconds, most, "s");
          reportTasks("drop", tasks);
        });
      }
    } finally {
      rmSync(folder, { recursive: true, force: true });
    }
  },

  /** Boxes and frames of a pawn in Chromium compared with the native engine. */
  async native() {
    const folder = process.env.SLICEWALK_ENGINE_CHECK;
    if (folder === undefined) throw new Error("set SLICEWALK_ENGINE_CHECK to the folder that `record` wrote");
    const native = JSON.parse(readFileSync(join(folder, "times.json"), "utf8"));
    const dist = join(dirname(fileURLToPath(import.meta.url)), "../package/dist");
    const names = ["scene.slices", "boxes.f64", "inputs.f64"];
    const files = Object.fromEntries(names.map((name) => [`/${name}`, join(folder, name)]));
    await within(dist, files, async (page, server) => {
      // Any page of this origin will do.
      await page.goto(`${server.address}index.js`);
      const found = await page.evaluate(answersInChromium, (MOST * native.frame_us) / 1000);
      const say = (name, unit, most) => {
        const what = `${name} (natively ${native[`${name}_${unit}`].toFixed(1)} ${unit})`;
        report("native", what, found[`${name}_${unit}`], most, unit);
      };
      say("box", "ns", MOST * native.box_ns);
      console.log(`      native: a bare message to a worker and back: ${found.message_us.toFixed(1)} us`);
      console.log(
        `      native: one to a worker that computes for ${(MOST * native.frame_us).toFixed(1)} us: ${found.busy_us.toFixed(1)} us`,
      );
      say("frame", "us", PASSING_US + found.busy_us);
    });
  },

  /** A run along a street over the link. */
  async street() {
    await within(DIST, { "/street.slices": street() }, async (page, server) => {
      reportWalk("street", await runAlong(page, server, "street.slices", STREET_M));
    });
  },

  /** Up the stairs of the house. */
  async house() {
    await within(DIST, { "/house.slices": house() }, async (page, server) => {
      await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
      await watch(page);
      for (const place of WAY.places) await walkTowards(page, place);
      reportTasks("house", (await watched(page)).tasks);
    });
  },

  /** A city: its outline from afar, and a run in its streets, both over the link. */
  async city() {
    const archive = city();
    const { levels } = JSON.parse(program("slicetool", "stats", archive, "--json"));
    await within(DIST, { "/city.slices": archive }, async (page, server) => {
      Object.assign(server, LINK);
      const begin = performance.now();
      await page.goto(address(server, { archive: "city.slices", at: CITY_START, look: [90, 0], view: "orbit" }));
      // All pages of a level, whichever level the page chose.
      const whole = ({ drawn }) => levels.some(({ pages }) => pages === drawn.overview);
      const { drawn } = await until(page, "the whole outline drawn", whole, { timeout: 120_000 });
      // As counted by the host: pending answers count in full.
      const asked = server.of("city.slices");
      const seconds = (performance.now() - begin) / 1000;
      const { level, pixel_size } = levels.find(({ pages }) => pages === drawn.overview);
      const what = `bytes until the outline is drawn (level ${level}, ${pixel_size} m, ${asked.length} requests, ${seconds.toFixed(1)} s)`;
      report("city", what, asked.reduce((sum, { bytes }) => sum + bytes, 0) / 1e6, OUTLINE_BYTES / 1e6, "MB");
    });
    await within(DIST, { "/city.slices": archive }, async (page, server) => {
      reportWalk("city", await runAlong(page, server, "city.slices", CITY_M, CITY_START));
    });
  },

  /**
   * The same house with and without colours: the first step, and frames up its stairs; then the cost of colours of
   * scans.
   */
  async colours() {
    const median = (values) => values.toSorted((a, b) => a - b)[values.length >> 1];
    const files = { "/coloured.slices": colouredHouse(), "/levelled.slices": levelledHouse() };
    const figures = {};
    for (let turn = 0; turn < TURNS; turn++) {
      for (const name of ["levelled", "coloured"]) {
        const own = (figures[name] ??= { steps: [], frames: CANVASES.map(() => []), tasks: [] });
        await within(DIST, files, async (page, server) => {
          own.steps.push(await firstStep(page, server, `${name}.slices`));
        });
        for (const [n, size] of CANVASES.entries()) {
          await within(DIST, files, async (page, server) => {
            await page.setViewportSize(size);
            await walkIn(page, address(server, { archive: `${name}.slices`, at: WAY.start, look: [0, 0] }));
            await watch(page);
            const begin = performance.now();
            for (const place of WAY.places) await walkTowards(page, place);
            const { frames, tasks } = await watched(page);
            own.frames[n].push((1000 * frames) / (performance.now() - begin));
            own.tasks.push(tasks.length);
          });
        }
      }
    }
    for (const [name, { steps, frames, tasks }] of Object.entries(figures)) {
      const { bytes, ranges } = steps[0];
      console.log(`      ${name}: first step after ${ranges.length} requests, ${bytes} bytes`);
      CANVASES.forEach(({ width, height }, n) => {
        const [least, most] = [Math.min(...frames[n]), Math.max(...frames[n])].map((rate) => rate.toFixed(1));
        const rate = `${median(frames[n]).toFixed(1)} frames a second (${least} to ${most})`;
        console.log(`      ${name}: ${rate} up the stairs at ${width} x ${height} pixels`);
      });
      console.log(`      ${name}: at most ${Math.max(...tasks)} long tasks in a run`);
    }
    const places = { "coloured.slices": { at: WAY.start, look: [0, 0] } };
    if (process.env.SLICEWALK_DATA !== undefined) {
      files["/pump_room.slices"] = scanned("pump_room", "--pixel", "0.02");
      files["/autzen_stadium.slices"] = scanned("autzen_stadium", "--levels", "on");
      Object.assign(places, { "pump_room.slices": { view: "orbit" }, "autzen_stadium.slices": { view: "orbit" } });
    }
    for (const [archive, place] of Object.entries(places)) {
      await within(DIST, files, async (page, server) => {
        await walkIn(page, address(server, { archive, ...place }));
        const whole = ({ drawn, colours }) => drawn.coloured > 0 && colours.missing === 0;
        await settled(page);
        const { requests, bytesLoaded, colours, drawn } = await until(page, "coloured", whole, { timeout: 120_000 });
        const all = `${requests - colours.requests} requests and ${bytesLoaded - colours.bytes} bytes of shapes`;
        const own = `${colours.requests} requests and ${colours.bytes} bytes of colours`;
        console.log(`      ${archive}: ${all}, ${own}; ${drawn.coloured} pages and ${drawn.distant} distant ones in colour`);
      });
    }
  },
};

/**
 * In the browser: minimum times of a box (ns), of a pawn's frame, of a message to a worker and back, and of one to a
 * worker that computes for `busyMs` (µs), alternating.
 */
async function answersInChromium(busyMs) {
  const { openArchive } = await import("/index.js");
  const read = async (name) => new Float64Array(await (await fetch(name)).arrayBuffer());
  const archive = await openArchive("/scene.slices");
  await archive.load({ min: [-100, -100, -100], max: [100, 100, 100] });
  const [boxes, inputs] = [await read("/boxes.f64"), await read("/inputs.f64")];
  const messages = (code) => {
    const worker = new Worker(URL.createObjectURL(new Blob([code])));
    return (data) =>
      new Promise((resolve) => {
        worker.onmessage = resolve;
        worker.postMessage(data);
      });
  };
  const message = messages("onmessage = ({ data }) => postMessage(data)");
  // A worker's clock is too coarse to wait by, so it counts at a rate that it calibrates first.
  const busy = messages(`
    let x = 1;
    const count = (n) => { for (; n > 0; n--) x = Math.sqrt(x + n); };
    const rate = () => { const start = performance.now(); count(1e7); return 1e7 / (performance.now() - start); };
    const each = Math.max(rate(), rate(), rate(), rate(), rate());
    onmessage = ({ data }) => { count(each * data); postMessage(x); };`);
  await busy(0);
  const least = { box_ns: Infinity, frame_us: Infinity, message_us: Infinity, busy_us: Infinity };
  const frames = 1800;
  for (let run = 0; run < 8; run++) {
    let start = performance.now();
    for (let frame = 0; frame < frames; frame++) await message();
    least.message_us = Math.min(least.message_us, ((performance.now() - start) * 1000) / frames);
    start = performance.now();
    for (let frame = 0; frame < frames; frame++) await busy(busyMs);
    least.busy_us = Math.min(least.busy_us, ((performance.now() - start) * 1000) / frames);
    start = performance.now();
    await archive.overlaps(boxes);
    least.box_ns = Math.min(least.box_ns, ((performance.now() - start) * 1e6) / (boxes.length / 6));
    const walker = await archive.walker({ at: [-2, 2, 0.2], crouchHeight: 1.1, jump: 0.6 });
    start = performance.now();
    for (let row = 0; row < 6 * frames; row += 6) {
      const [seconds, x, y, pace, lift, flags] = inputs.subarray(row, row + 6);
      if (flags === -1) await walker.place([x, y, pace]);
      else {
        const way = flags & 8 ? { toward: [x, y] } : { wish: [x, y] };
        await walker.step(seconds, { ...way, pace, lift, jump: !!(flags & 1), crouch: !!(flags & 2), fly: !!(flags & 4) });
      }
    }
    least.frame_us = Math.min(least.frame_us, ((performance.now() - start) * 1000) / frames);
    walker.close();
  }
  return least;
}

const chosen = process.argv.length > 2 ? process.argv.slice(2) : Object.keys(parts);
const unknown = chosen.find((name) => !(name in parts));
if (unknown !== undefined) {
  console.error(`bench.js: no part '${unknown}'; parts: ${Object.keys(parts).join(", ")}`);
  process.exit(2);
}
for (const name of chosen) await parts[name]();
