// Boxes and frames of a pawn in Chromium beside the native engine. By hand, on a quiet machine: `.ci/long viewer`.
//
// SLICEWALK_ENGINE_CHECK names the folder that `record` wrote, built with optimisation: its times are the native ones.

import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { launch } from "./browser.js";
import { StaticServer } from "./static-server.js";

/** At most so many times the native time, and for a frame so much more: it passes between two threads (µs). */
const MOST = 2;
const PASSING_US = 50;

const folder = process.env.SLICEWALK_ENGINE_CHECK;
const native = JSON.parse(readFileSync(join(folder, "times.json"), "utf8"));
const dist = join(dirname(fileURLToPath(import.meta.url)), "../package/dist");
const named = Object.fromEntries(["scene.slices", "boxes.f64", "inputs.f64"].map((name) => [`/${name}`, join(folder, name)]));
const server = await new StaticServer(dist, named).start();
const browser = await launch();
try {
  const page = await browser.newPage();
  // Any page of this origin.
  await page.goto(`${server.address}index.js`);
  const found = await page.evaluate(async () => {
    const { openArchive } = await import("/index.js");
    const read = async (name) => new Float64Array(await (await fetch(name)).arrayBuffer());
    const archive = await openArchive("/scene.slices");
    await archive.load({ min: [-100, -100, -100], max: [100, 100, 100] });
    const [boxes, inputs] = [await read("/boxes.f64"), await read("/inputs.f64")];
    const least = { box_ns: Infinity, frame_us: Infinity };
    for (let run = 0; run < 5; run++) {
      let start = performance.now();
      await archive.overlaps(boxes);
      least.box_ns = Math.min(least.box_ns, ((performance.now() - start) * 1e6) / (boxes.length / 6));
      const walker = await archive.walker({ at: [-2, 2, 0.2], crouchHeight: 1.1, jump: 0.6 });
      start = performance.now();
      const frames = 1800;
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
  });
  const limits = { box_ns: MOST * native.box_ns, frame_us: MOST * native.frame_us + PASSING_US };
  for (const name of ["box_ns", "frame_us"]) {
    const line = `${name}: ${found[name].toFixed(1)} in Chromium, ${native[name].toFixed(1)} natively`;
    console.log(`${line} (at most ${limits[name].toFixed(1)})`);
    if (found[name] > limits[name]) process.exitCode = 1;
  }
} finally {
  await browser.close();
  await server.stop();
}
