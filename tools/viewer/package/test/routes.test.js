// Routes of the engine beside those of `slicetool route` between the same places.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { existsSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { openArchive } from "../dist/index.js";
import { FileHost, folder, read } from "./local.js";

const slicetool = join(process.env.SLICEWALK_BIN ?? new URL("../../../../target/debug", import.meta.url).pathname, "slicetool");
// Without a route, slicetool looks for what blocks it, which takes seconds.
const PAIRS = 16;

/** Numbers from 0 to 1, the same in every run. */
function* random(seed) {
  for (let state = seed; ;) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    yield state / 2 ** 32;
  }
}

test(
  "routes connect what slicetool connects, and are no longer",
  { skip: !existsSync(slicetool) && "slicetool is not built" },
  async () => {
    const archive = await openArchive("http://host/scene.slices", { worker: new FileHost(read("scene.slices")).worker });
    const { min, max } = archive.info.bounds;
    const numbers = random(41);
    const between = (axis) => min[axis] + numbers.next().value * (max[axis] - min[axis]);
    const seen = { found: 0, straight: 0, refused: 0 };
    for (let n = 0; n < PAIRS; n++) {
      const [from, to] = [0, 1].map(() => [between(0), between(1), [0.1, 3.1][n % 2]]);
      const words = [from, to].map((place, k) => `--${["from", "to"][k]}=${place.join(",")}`);
      const expected = JSON.parse(
        execFileSync(slicetool, ["route", join(folder, "scene.slices"), ...words, "--json"], { encoding: "utf8" }),
      );
      const walker = await archive.walker({ at: from });
      const route = await walker.route(to);
      walker.close();
      const what = `${words.join(" ")}: ${JSON.stringify(route)}`;
      if (!expected.found) {
        // The engine names the reasons with hyphens.
        assert.equal(route, expected.reason.replaceAll("_", "-"), what);
        seen.refused++;
        continue;
      }
      assert.equal(typeof route, "object", what);
      // A straight way is no route over pixels, and begins where the pawn is.
      if (route.points.length === 2) seen.straight++;
      assert.ok(route.length <= expected.length_m * 1.001 + 0.2, `${what} is longer than ${expected.length_m} m`);
      assert.ok(route.length >= expected.length_m / 1.09 - 0.2, `${what} is shorter than ${expected.length_m} m`);
      seen.found++;
    }
    assert.ok(seen.found - seen.straight > 5 && seen.straight > 0 && seen.refused > 3, JSON.stringify(seen));
    console.log(`# ${JSON.stringify(seen)}`);
    archive.close();
  },
);
