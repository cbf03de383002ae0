// Walking: stairs, walls, falls, far from the origin, and with every device.

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, beforeEach, describe } from "node:test";
import { hold, it, pages, state, until, walkIn } from "./browser.js";
import { BIN, colouredHouse, DIST, house, movedHouse, MOVED, street, tower, WAY } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { address, firstStep, runAlong, walkTowards } from "./steer.js";

let server, page;
const tests = pages();

before(async () => {
  server = await new StaticServer(DIST, {
    "/house.slices": house(),
    "/coloured.slices": colouredHouse(),
    "/moved.slices": movedHouse(),
    "/tower.slices": tower(),
    "/street.slices": street(),
  }).start();
});
after(async () => {
  await server?.stop();
});
beforeEach(() => {
  server.requests.length = 0;
  Object.assign(server, { delayMs: 0, bytesPerSecond: Infinity });
  page = tests.page;
});

/** Up the stairs by keys, recorded. */
async function climb(archive, shift) {
  const there = ([x, y]) => [x + shift[0], y + shift[1]];
  await walkIn(page, address(server, { archive, at: [...there(WAY.start), WAY.start[2]], look: [0, 0] }));
  await page.evaluate(() => window.slicewalk.record());
  for (const place of WAY.places) await walkTowards(page, there(place));
  const { at } = await until(page, "standing", ({ ground, speed }) => ground !== "falling" && speed === 0);
  assert.ok(Math.abs(at[2] - 3) < 0.03, `at z = ${at[2]}`);
  return page.evaluate(() => window.slicewalk.recording());
}

/** The library walks the recorded inputs again and compares each place bit for bit. */
function replay(archive, recording) {
  assert.ok(recording.steps.length > 50 * 8 && recording.path.length * 8 === recording.steps.length * 3);
  const folder = mkdtempSync(join(tmpdir(), "slicewalk-replay-"));
  try {
    const file = join(folder, "recording.json");
    writeFileSync(file, JSON.stringify(recording));
    return execFileSync(join(BIN, "replay"), [archive, file], { encoding: "utf8" });
  } finally {
    rmSync(folder, { recursive: true });
  }
}

describe("walking", () => {
  for (const archive of ["house.slices", "coloured.slices"]) {
    it(`takes the first step in ${archive} after at most 5 range requests and 300 kB, colours last`, async (t) => {
      server.delayMs = 200;
      const { bytes, ranges, early } = await firstStep(page, server, archive);
      t.diagnostic(`${ranges.length} requests, ${bytes} bytes`);
      assert.ok(ranges.length <= 5 && bytes <= 300_000, `${ranges.length} requests, ${bytes} bytes: ${ranges.join(" ")}`);
      // A slow machine may ask for colours before it draws the first step, but never before it has the pages.
      assert.ok(!early, "colours were asked for while pages were missing");
    });
  }

  it("runs along a street on a link of 20 Mbit/s and 40 ms", async (t) => {
    // How often it waits also depends on the machine: `bench.js` requires no wait, and the engine's own tests use a
    // simulated clock.
    const { waited, bytesLoaded } = await runAlong(page, server, "street.slices", 30);
    t.diagnostic(`at most ${waited} pages missing in a frame`);
    assert.ok(bytesLoaded > 1e6, `${bytesLoaded} bytes`);
  });

  it("climbs the stairs by keys, and the library does the same to the last bit", async () => {
    const recording = await climb("house.slices", [0, 0]);
    replay(house(), recording);
    // A replay that differs is detected.
    const bent = { ...recording, path: recording.path.with(-1, recording.path.at(-1) + 1e-12) };
    assert.throws(() => replay(house(), bent));
  });

  it("climbs them 5,000 km from the origin as well", async () => {
    const recording = await climb("moved.slices", MOVED);
    replay(movedHouse(), recording);
  });

  it("stops at a wall and says so", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [270, 0] }));
    const before = await hold(page, ["w"], "blocked", ({ ground }) => ground === "blocked");
    // Half the pawn and at most a pixel of solid before the wall.
    assert.ok(before.at[0] >= 0.25 && before.at[0] <= 0.25 + 2 * 0.05, `x = ${before.at[0]}`);
    await page.locator("details.status").evaluate((panel) => (panel.open = true));
    await page.keyboard.down("w");
    await page.getByText("stopped by a wall").waitFor();
    await page.keyboard.up("w");
  });

  it("stops before a drop of 150 m, and lands after it without the guard rail", async () => {
    const edge = { archive: "tower.slices", at: [-2.25, 0, 150], look: [90, 0] };
    await walkIn(page, address(server, edge));
    await hold(page, ["w"], "at the edge", ({ ground, at }) => ground === "blocked" && at[0] > -2);
    assert.ok(Math.abs((await state(page)).at[2] - 150) < 0.3);
    await page.evaluate(() => localStorage.setItem("slicewalk.settings", JSON.stringify({ drop: 0 })));
    const top = await walkIn(page, address(server, edge));
    assert.ok(Math.abs(top.at[2] - 150) < 0.3, `starts at z = ${top.at[2]}`);
    await hold(page, ["w"], "falling", ({ ground }) => ground === "falling");
    const end = await until(page, "landed", ({ ground, at }) => ground === "walking" && at[2] < 1, { timeout: 120_000 });
    assert.ok(Math.abs(end.at[2]) < 0.3, `z = ${end.at[2]}`);
  });

  it("jumps, crouches and flies through walls", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [270, 0] }));
    await page.keyboard.press("Space");
    await until(page, "in the air", ({ at }) => at[2] > 0.15);
    await until(page, "on its feet", ({ at, ground }) => at[2] < 0.05 && ground === "walking");
    await page.keyboard.press("f");
    await hold(page, ["w"], "beyond the wall", ({ at, ground }) => at[0] < -1 && ground === "flying");
    await page.keyboard.press("f");
    await until(page, "falling", ({ ground }) => ground === "falling");
  });

  it("walks, turns and looks by the keyboard alone", async () => {
    const { at: from } = await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    const far = ({ at }) => Math.hypot(at[0] - from[0], at[1] - from[1]) >= 1;
    await hold(page, ["ArrowUp"], "a metre on", far);
    const { look } = await state(page);
    await hold(page, ["ArrowRight"], "turned", ({ look: now }) => now[0] - look[0] > 20);
    await hold(page, ["PageDown"], "looking down", ({ look: now }) => now[1] < -15);
    // A view that rests is drawn no more, apart from a picture each few seconds.
    const drawn = async (ms) => {
      const { pictures } = await state(page);
      await page.waitForTimeout(ms);
      return (await state(page)).pictures - pictures;
    };
    for (const end = Date.now() + 60_000; (await drawn(2500)) > 1;) assert.ok(Date.now() < end, "it is drawn on and on");
    const { pictures, frames } = await state(page);
    const now = await hold(page, ["ArrowRight"], "drawn again", (now) => now.pictures > pictures + 2);
    assert.ok(now.frames > frames);
  });

  it("runs with shift", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await hold(page, ["w"], "walking", ({ speed }) => Math.abs(speed - 1.4) < 0.05);
    await page.evaluate((at) => window.slicewalk.goto({ at }), WAY.start);
    await hold(page, ["Shift", "w"], "running", ({ speed }) => speed > 2.5);
  });

  it("walks by a gamepad", async () => {
    await page.addInitScript(() => {
      const pad = {
        connected: true,
        mapping: "standard",
        axes: [0, 0, 0, 0],
        buttons: Array.from({ length: 17 }, () => ({ pressed: false, value: 0 })),
      };
      Object.assign(window, { pad });
      navigator.getGamepads = () => [pad, null, null, null];
    });
    const { at: from } = await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await page.evaluate(() => (window.pad.axes[1] = -1));
    await until(page, "a metre on", ({ at }) => at[1] - from[1] >= 1);
    await page.evaluate(() => {
      window.pad.axes[1] = 0.05;
      window.pad.axes[2] = 1;
    });
    await until(page, "turned", ({ look }) => look[0] > 20 && look[0] < 340);
    await page.evaluate(() => (window.pad.axes[2] = 0));
    await until(page, "standing", ({ speed }) => speed === 0);
  });
});

describe("touch", () => {
  it("walks and looks with two thumbs", async () => {
    const phone = await tests.browser.newPage({ viewport: { width: 740, height: 560 }, hasTouch: true, isMobile: true });
    try {
      const { at: from } = await walkIn(phone, address(server, { at: WAY.start, look: [0, 0] }));
      const thumb = async (name) => {
        const box = await phone.getByRole("group", { name }).boundingBox();
        return { x: box.x + box.width / 2, y: box.y + box.height / 2 };
      };
      await phone.getByRole("group", { name: "Walking stick" }).waitFor();
      const touch = await phone.context().newCDPSession(phone);
      const send = (type, ...points) => touch.send("Input.dispatchTouchEvent", { type, touchPoints: points });
      const left = await thumb("Walking stick");
      await send("touchStart", left);
      await send("touchMove", { x: left.x, y: left.y - 45 });
      await until(phone, "a metre on", ({ at }) => at[1] - from[1] >= 1);
      await send("touchEnd");
      const right = await thumb("Looking stick");
      await send("touchStart", right);
      await send("touchMove", { x: right.x + 45, y: right.y });
      await until(phone, "turned", ({ look }) => look[0] > 20 && look[0] < 340);
      await send("touchEnd");
      await until(phone, "standing", ({ speed }) => speed === 0);
      assert.deepEqual(phone.complaints, []);
    } finally {
      await phone.end();
    }
  });
});
