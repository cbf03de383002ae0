// Other features of the page: places by clicks and links, slices, measures, local files, screenshots; and
// accessibility.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after, before, beforeEach, describe } from "node:test";
import { drop, hold, it, pages, pixels, state, until, walkIn } from "./browser.js";
import { avenue, colourBytes, colouredAvenue, colouredHouse, DIST, house, program, WAY } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { address } from "./steer.js";

const script = (path) => readFileSync(createRequire(import.meta.url).resolve(path), "utf8");
const AXE = script("axe-core/axe.min.js");
const IWER = script("iwer/build/iwer.min.js");
const PIXEL = 0.05;
let server, page;
const tests = pages();

before(async () => {
  const files = {
    "/house.slices": house(),
    "/coloured.slices": colouredHouse(),
    "/avenue.slices": avenue(),
    "/coloured-avenue.slices": colouredAvenue(),
  };
  server = await new StaticServer(DIST, files).start();
});
after(async () => {
  await server?.stop();
});
beforeEach(() => {
  page = tests.page;
});

const tool = (name) => page.getByRole("button", { name, exact: false });
const middle = { x: 400, y: 250 };

/** Number of different colours in the middle of the screen. */
async function colours() {
  return new Set((await pixels(page)).map((rgb) => rgb.map((value) => value >> 3).join())).size;
}

/** Waits until the picture shows what `fits` awaits; `what` names it if it never does. */
async function shown(what, fits) {
  for (const end = Date.now() + 60_000; !(await fits()); await page.waitForTimeout(200)) {
    if (Date.now() > end) throw new Error(`never shown: ${what}`);
  }
}

/** Waits until something is drawn: more colours than a plain background has. */
const drawn = () => shown("anything", async () => (await colours()) >= 12);

/** Waits until a plan is drawn: walls in ink, floor in white. */
const planned = () => shown("a plan", async () => (await pixels(page)).filter((rgb) => Math.max(...rgb) < 40).length >= 20);

/** Clicks a place in a plan whose pawn stands at the start of the way. */
async function clickPlan([x, y]) {
  // The plan has north above; where it is clicked twice, the pawn is at once. Its first click may have made it walk before.
  const jump = async (right, up) => {
    const before = (await state(page)).at;
    await page.mouse.dblclick(middle.x + right, middle.y - up);
    let last = before;
    const rests = ({ at, speed, missing }) => {
      const moved = Math.hypot(at[0] - last[0], at[1] - last[1]);
      last = at;
      return moved === 0 && speed === 0 && missing === 0 && Math.hypot(at[0] - before[0], at[1] - before[1]) > 0.2;
    };
    await until(page, "elsewhere", rests);
    await page.waitForTimeout(1000);
    return (await until(page, "at rest", rests)).at;
  };
  const [origin, off] = [await jump(10, 10), await jump(-40, -40)];
  const scale = (origin[0] - off[0]) / 50;
  await page.evaluate((at) => window.slicewalk.goto({ at }), WAY.start);
  await until(page, "back", ({ at, missing }) => Math.abs(at[1] - WAY.start[1]) < 0.01 && missing === 0);
  // The pawn is in the middle again.
  await page.mouse.click(middle.x + (x - WAY.start[0]) / scale, middle.y - (y - WAY.start[1]) / scale);
}

/** The text of the file that is saved when `save` is clicked. */
async function savedText(save) {
  const [download] = await Promise.all([page.waitForEvent("download"), save.click()]);
  const text = Buffer.concat(await (await download.createReadStream()).toArray()).toString("utf8");
  return { name: download.suggestedFilename(), text };
}

/**
 * Fraction of the middle of the screen, without the background, that is distinctly blue or green: colours of the
 * formula, which the page itself never uses.
 */
async function vivid(page) {
  // The sky is bright and nearly grey.
  const sky = (rgb) => Math.min(...rgb) > 150 && Math.max(...rgb) - Math.min(...rgb) < 24;
  const seen = (await pixels(page)).filter((rgb) => Math.max(...rgb) > 40 && !sky(rgb));
  return seen.filter(([r, g, b]) => Math.max(g, b) - Math.min(r, g, b) > 60 && Math.max(g, b) > r).length / seen.length;
}

/** Waits until that fraction fits. */
async function becomes(what, fits) {
  const end = Date.now() + 20_000;
  while (!fits(await vivid(page))) assert.ok(Date.now() < end, what);
}

/** Fraction of the picture in the scan's colours, which disappear when colours by kind are chosen. */
async function ownColours(page) {
  await becomes("the picture has the colours of the scan", (now) => now > 0.05);
  const own = await vivid(page);
  await tool("Colours").click();
  await page.getByLabel("Floor and obstacle").check();
  await becomes("colours by kind are others", (now) => now < own / 4);
  return own;
}

describe("colours", () => {
  const coloured = ({ drawn, colours }) => drawn.coloured > 10 && colours.missing === 0;

  it("shows the colours of the scan, which come after its shapes", async () => {
    await walkIn(page, address(server, { archive: "coloured.slices", at: WAY.start, look: [0, -30] }));
    // The first step needs none (`walk.test.js`); here the first may be in flight already.
    const early = await state(page);
    const { colours, drawn, bytesLoaded, requests } = await until(page, "coloured", coloured);
    assert.ok(early.drawn.coloured < drawn.coloured, JSON.stringify(early));
    assert.ok(colours.requests > 2 && colours.requests < requests, JSON.stringify({ colours, requests }));
    assert.ok(colours.bytes > 0 && colours.bytes < bytesLoaded);
    assert.ok(drawn.coloured <= drawn.pages);
    const own = await ownColours(page);
    await page.getByLabel("Scan", { exact: true }).check();
    await becomes("and back", (now) => now > own / 2);
  });

  it("draws what is far away in the scan's colours too", async () => {
    const there = { archive: "coloured-avenue.slices", at: [150, 0, 0.1], look: [0, -60] };
    await walkIn(page, address(server, { ...there, view: "orbit" }));
    await page.mouse.move(middle.x, middle.y);
    // So far out that only the overview level is drawn.
    const far = ({ drawn }) => drawn.pages === 0 && drawn.overview > 0 && drawn.distant === drawn.overview;
    for (let n = 0; n < 6; n++) await page.mouse.wheel(0, 200);
    const { drawn } = await until(page, "the level alone, coloured", far, { timeout: 120_000 });
    assert.equal(drawn.coloured, 0, JSON.stringify(drawn));
    await ownColours(page);
  });

  it("walks on while an answer of colours does not come, and gives it up for what the pawn waits for", async () => {
    const [begin, end] = colourBytes(colouredAvenue());
    // The first read of an archive includes some of its end, whatever that contains.
    const isOfColours = (first, last) => first >= begin && last < end;
    Object.assign(server, { holds: isOfColours, requests: [] });
    const held = () =>
      server.of("coloured-avenue.slices").filter(({ range }) => isOfColours(...(range?.match(/\d+/g) ?? []).map(Number)));
    const waiting = () => held().filter(({ status }) => status === 206);
    try {
      await walkIn(page, address(server, { archive: "coloured-avenue.slices", at: [2, 0, 0.1], look: [90, 0] }));
      await until(page, "colours asked for", () => waiting().length > 0);
      const { at } = await hold(page, ["Shift", "w"], "8 m on", (now) => now.at[0] > 10);
      assert.ok(Math.abs(at[2]) < 0.3, `z = ${at[2]}`);
      await until(page, "colours asked for", () => waiting().length > 0);
      const before = waiting();
      // Far beyond the pages in memory.
      await page.evaluate(() => window.slicewalk.goto({ at: [290, 0, 0.1], look: [-90, 0] }));
      const { missing, colours } = await until(page, "there", (now) => now.at[0] > 280 && now.missing === 0);
      // Colours within the end of the archive, which was read first, may be drawn: they cost no request.
      assert.deepEqual([missing, colours.bytes], [0, 0]);
      // At the latest when the pawn runs into pages that come later than it.
      server.delayMs = 3000;
      await hold(page, ["Shift", "w"], "the first requests closed", () => before.every(({ status }) => status === 0));
      await until(page, "colours asked for again", () => waiting().length > 0);
    } finally {
      Object.assign(server, { holds: () => false, delayMs: 0 });
    }
  });

  it("offers no colours of a scan without", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    await tool("Colours").click();
    await page.getByLabel("Height", { exact: true }).waitFor({ state: "visible" });
    assert.ok(!(await page.getByLabel("Scan", { exact: true }).isVisible()));
    assert.ok(await page.getByLabel("Height", { exact: true }).isChecked());
    const { colours, drawn } = await state(page);
    assert.deepEqual([colours.requests, drawn.coloured], [0, 0]);
  });
});

describe("places", () => {
  it("restores a link's place and view", async () => {
    await walkIn(page, address(server, { at: [9.25, 4.5, 3], look: [123, -12] }));
    await until(page, "standing on the first floor", ({ at }) => Math.abs(at[2] - 3) < 0.02);
    const { at, look, mode } = await state(page);
    assert.deepEqual([at[0], at[1]], [9.25, 4.5]);
    assert.deepEqual(look, [123, -12]);
    assert.equal(mode, "walk");
    await tool("Copy link").click();
    await page.waitForURL(/look=123,-12/);
    const link = page.url();
    await page.goto("about:blank");
    await walkIn(page, link);
    const again = await state(page);
    assert.ok(
      again.at.every((value, axis) => Math.abs(value - at[axis]) < 0.01),
      `${again.at}`,
    );
    assert.deepEqual(again.look, look);
    await page.goto("about:blank");
    await walkIn(page, `${address(server, { at: WAY.start, view: "plan" })}&lang=de`);
    assert.equal((await state(page)).mode, "plan");
    await tool("Link kopieren").click();
    await page.waitForURL(/look=.*view=plan&lang=de/);
  });

  it("goes where a program sends it, and is loaded then", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    const { at, look, missing } = await page.evaluate(async () => {
      await window.slicewalk.goto({ at: Float64Array.of(9.25, 4.5, 6.2), look: [90, 10] });
      return window.slicewalk.state();
    });
    assert.deepEqual([at[0], at[1], look, missing], [9.25, 4.5, [90, 10], 0]);
    await until(page, "on the floor", ({ at: now }) => Math.abs(now[2] - 6) < 0.02);
    // Numbers that are none are refused before anything moves, and the archive stays open, whatever is looked at next.
    const nowhere = (place) => window.slicewalk.goto(place).catch(({ kind, message }) => `${kind}: ${message}`);
    assert.match(await page.evaluate(nowhere, { look: [Number.NaN, 0] }), /^invalid: a look is two finite numbers/);
    for (const x of [Number.NaN, 1e10]) {
      const said = await page.evaluate(nowhere, { at: [x, 0, 0], look: [0, 0] });
      assert.match(said, /^invalid: a place is three numbers within ±1e9 m/);
    }
    await page.keyboard.press("o");
    const { mode, look: kept, error } = await until(page, "from outside", (now) => now.mode === "orbit");
    assert.deepEqual([mode, kept, error], ["orbit", [90, 10], null]);
  });

  it("walks there by a click and is there at once by two", async () => {
    const { at: from } = await walkIn(page, address(server, { at: WAY.start, view: "plan" }));
    await planned();
    await page.mouse.dblclick(middle.x, middle.y - 40);
    const near = await until(page, "elsewhere", ({ at }) => Math.hypot(at[0] - from[0], at[1] - from[1]) > 0.4);
    assert.ok(Math.abs(near.at[2]) < 0.05, `on the floor below the cut: z = ${near.at[2]}`);
    await page.mouse.click(middle.x, middle.y + 30);
    await until(page, "walking there", ({ speed }) => speed > 0.5);
    const there = await until(page, "arrived", ({ at, speed }) => at[1] !== near.at[1] && speed === 0);
    assert.equal(there.ground, "walking");
    // A search for a route that fails does not keep the pawn waiting.
    await page.evaluate(() => {
      const post = Worker.prototype.postMessage;
      Worker.prototype.postMessage = function (message, ...rest) {
        const isRoute = message?.call === "route";
        return post.call(this, isRoute ? { ...message, to: new Float64Array(3).fill(NaN) } : message, ...rest);
      };
    });
    await page.mouse.click(middle.x, middle.y - 30);
    await until(page, "on its way", ({ at }) => Math.hypot(at[0] - there.at[0], at[1] - there.at[1]) > 0.3);
  });

  it("walks through the door to where the straight way is blocked", async () => {
    await walkIn(page, address(server, { at: WAY.start, view: "plan" }));
    await planned();
    const [x, y] = [6.4, 2.5];
    await clickPlan([x, y]);
    await page.evaluate(() => window.slicewalk.record());
    const end = await until(page, "arrived", ({ at, speed }) => at[0] > 5.5 && speed === 0, { timeout: 60_000 });
    assert.ok(Math.hypot(end.at[0] - x, end.at[1] - y) < 0.4, `${end.at}`);
    // The middle of the wall is at x = 4.9, that of the door at y = 5.
    const { path } = await page.evaluate(() => window.slicewalk.recording());
    const places = Array.from({ length: path.length / 3 }, (_, n) => path.slice(3 * n, 3 * n + 2));
    const crossed = places.flatMap(([x1, y1], n) => {
      const [x0, y0] = places[n - 1] ?? [x1, y1];
      return x0 < 4.9 !== x1 < 4.9 ? [y0 + ((y1 - y0) * (4.9 - x0)) / (x1 - x0)] : [];
    });
    assert.ok(crossed.length === 1 && Math.abs(crossed[0] - 5) < 0.3, `through the door at y = 5: ${crossed}`);
  });

  it("marks where the way is blocked, and which pawn gets through, as slicetool does", async () => {
    const [width, to] = [1.2, [6.4, 2.5, 0]];
    // So slow that what is said first is gone when the pawn is at the door.
    const settings = JSON.stringify({ width, speed: 0.5 });
    await page.addInitScript((settings) => localStorage.setItem("slicewalk.settings", settings), settings);
    await walkIn(page, address(server, { at: WAY.start, view: "plan" }));
    await planned();
    // News go by: a slow test would miss them.
    await page.evaluate(() => {
      window.news = [];
      const shown = document.querySelector(".news");
      new MutationObserver(() => window.news.push(shown.textContent)).observe(shown, { childList: true });
    });
    const said = async (pattern) => (await page.evaluate(() => window.news)).flatMap((text) => pattern.exec(text) ?? []);
    await clickPlan(to);
    const ends = [`--from=${WAY.start.join(",")}`, `--to=${to.join(",")}`, "--pawn", `box:${width}x${width}x1.8`];
    const { blocked } = JSON.parse(program("slicetool", "route", house(), ...ends, "--json"));
    assert.equal(blocked.reason, "width");
    const atDoor = ({ at, speed }) => Math.hypot(at[0] - blocked.x, at[1] - blocked.y) < 0.5 && speed === 0;
    await until(page, "before the door", atDoor, { timeout: 120_000 });
    const narrow = /(?<=too narrow at the mark\. A pawn )\d+\.\d+/;
    await page.waitForFunction(() => window.news.filter((text) => text.includes("too narrow at the mark")).length === 2);
    const needs = Number((await said(narrow))[0]);
    assert.ok(Math.abs(needs - blocked.needs) <= 0.06, `${needs} m, and ${blocked.needs} m by slicetool`);
    assert.equal((await said(/Looking for what blocks it/)).length, 1);
  });

  it("looks no longer for what blocks the way of a pawn that goes elsewhere", async () => {
    await page.addInitScript(() => localStorage.setItem("slicewalk.settings", JSON.stringify({ width: 1.2 })));
    await walkIn(page, address(server, { at: WAY.start, view: "plan" }));
    await planned();
    await clickPlan([6.4, 2.5]);
    const news = (text) => document.querySelector(".news").textContent.includes(text);
    await page.waitForFunction(news, "Looking for what blocks it");
    await page.keyboard.down("w");
    await page.waitForFunction((text) => !document.querySelector(".news").textContent.includes(text), "Looking for");
    await page.keyboard.up("w");
    await page.waitForTimeout(2000);
    assert.doesNotMatch(await page.textContent(".news"), /too narrow|Looking for/);
  });

  it("captures the mouse by a click in the walk view, without a step", async () => {
    const { at } = await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await page.mouse.click(middle.x, middle.y);
    await page.waitForFunction(() => document.pointerLockElement !== null);
    await page.mouse.move(middle.x + 120, middle.y);
    await until(page, "turned", ({ look }) => look[0] !== 0);
    await page.waitForTimeout(400);
    assert.deepEqual((await state(page)).at.slice(0, 2), at.slice(0, 2));
    await page.evaluate(() => document.exitPointerLock());
  });

  it("is at once far beyond the pages in memory by two clicks", async () => {
    const start = await walkIn(page, address(server, { archive: "avenue.slices", at: [2, 0, 0.1], look: [90, -1] }));
    await until(page, "the outline", ({ drawn }) => drawn.overview > 0);
    await page.mouse.click(middle.x, middle.y);
    await page.waitForFunction(() => document.pointerLockElement !== null);
    const { look, at } = await state(page);
    for (let n = 0; n < 2; n++) {
      await page.mouse.down();
      await page.mouse.up();
    }
    const far = await until(page, "elsewhere", (now) => now.at[0] > at[0] + 30, { timeout: 60_000 });
    await page.evaluate(() => document.exitPointerLock());
    // From the eye down to the street.
    const expected = at[0] + 1.65 / Math.tan((-look[1] * Math.PI) / 180);
    assert.ok(Math.abs(far.at[0] - expected) < 0.25 * expected, `${start.at} to ${far.at}, expected x = ${expected}`);
    assert.ok(Math.abs(far.at[2]) < 0.3, `z = ${far.at[2]}`);
    // Not before the click: the outline may be complete before any page is loaded.
    assert.ok(far.pages.resident > 0);
  });

  it("chooses a place to stand when the address names none", async () => {
    await walkIn(page, `${server.address}?archive=house.slices`);
    const { at, ground } = await until(page, "standing", (now) => now.ground === "walking" && now.speed === 0);
    assert.ok(Math.abs(at[2]) < 0.05 && at[0] > 0 && at[0] < 14 && at[1] > 0 && at[1] < 10, `${at}, ${ground}`);
  });
});

describe("tools", () => {
  it("shows one slice and marks the pawn's", async () => {
    await walkIn(page, address(server, { at: WAY.start, view: "plan" }));
    await planned();
    await tool("Slices").click();
    await drawn();
    const slider = page.getByRole("slider", { name: "Slice" });
    await page.getByText(/The pawn stands in slice \d+/).waitFor();
    const many = await colours();
    await slider.focus();
    await page.keyboard.press("Home");
    const text = () => slider.getAttribute("aria-valuetext");
    assert.match(await text(), /^Slice 0 of \d+: z from -0\.\d+ to -?0\.\d+ m$/);
    await page.keyboard.press("ArrowRight");
    assert.match(await text(), /^Slice 1 of /);
    assert.ok(await page.getByLabel("Show one slice only").isChecked());
    await page.keyboard.press("End");
    await shown("another slice", async () => (await colours()) !== many);
  });

  it("measures a door of 1 m, its headroom and a step", async () => {
    // The middle of the screen is on the floor between the jambs: the wall stands from x = 4.8 to 5.
    await walkIn(page, address(server, { at: [3.25, 5, 0], look: [90, -45] }));
    await tool("Measure").click();
    const row = (name) => page.locator(`[data-measure=${name}]`);
    const value = async (name) => {
      const cell = row(name).and(page.locator("[data-metres]"));
      await cell.waitFor();
      return Number(await cell.getAttribute("data-metres"));
    };
    const place = () => row("place").textContent();
    // Anywhere between the jambs, whether or not a point of the floor is under the cursor.
    // prettier-ignore
    for (const [right, down] of [[0, 0], [-12, 6], [14, -5], [5, 9], [-7, -8], [20, 3], [-19, -2]]) {
      const before = await place();
      await page.mouse.move(middle.x + right, middle.y + down);
      await page.waitForFunction((text) => document.querySelector("[data-measure=place]").textContent !== text, before);
      const [width, headroom] = [await value("width"), await value("headroom")];
      const where = `${await place()}, (${right}, ${down}) px from the middle`;
      assert.ok(Math.abs(width - 1) <= 2 * PIXEL, `the door is ${width} m wide at ${where}`);
      assert.ok(Math.abs(headroom - 2.1) <= 0.03, `headroom ${headroom} m at ${where}`);
    }
    // At the foot of the stairs: a riser of 3 m / 17.
    await page.evaluate(() => window.slicewalk.goto({ at: [13.45, 0.6, 0], look: [0, -50] }));
    const end = Date.now() + 30_000;
    for (let step = NaN; !(Math.abs(step - 3 / 17) < 0.02);) {
      assert.ok(Date.now() < end, `a step of ${step} m`);
      await page.mouse.move(middle.x, middle.y - Math.random() * 20);
      await page.waitForTimeout(200);
      step = Number((await row("step").getAttribute("data-metres")) ?? NaN);
    }
    // Two places on a level floor.
    await page.evaluate(() => window.slicewalk.goto({ at: [8, 5, 0], look: [90, -40] }));
    await until(page, "there", ({ at, missing }) => Math.abs(at[0] - 8) < 0.1 && missing === 0);
    // A click counts once the place under it is known; whichever two count, they are as far apart.
    const measured = row("height").and(page.locator("[data-metres]"));
    for (let clicks = 0; (await measured.count()) === 0; clicks++) {
      assert.ok(clicks < 40, "two places are measured");
      await page.mouse.click(middle.x, middle.y + (clicks % 2) * 120);
      await page.waitForTimeout(600);
    }
    const [height, across] = [await value("height"), await value("across")];
    assert.ok(Math.abs(height) < 0.02 && across > 0.3 && across < 2, `${across} m across, ${height} m up`);
  });

  it("saves a plan true to scale: walls where they stand, doors between them", async () => {
    await walkIn(page, address(server, { at: WAY.start, view: "plan" }));
    await planned();
    const { name, text } = await savedText(page.getByRole("button", { name: "Save as SVG" }));
    assert.equal(name, "house-plan.svg");
    const attribute = (tag, key) => new RegExp(`<${tag}[^>]* ${key}="([^"]*)"`).exec(text)?.[1];
    assert.match(attribute("svg", "width"), /^[\d.]+mm$/);
    assert.match(text, /cut at z = 1.2\d m · 1 : 50\n/, "as large as A3 takes 14 × 10 m");
    assert.equal((text.match(/>14</g) ?? []).length, 1, "the grid says where x = 14 is");
    // The line x = 14 and its neighbour, a metre apart, tell where places are on paper.
    const lines = [...text.matchAll(/<path d="M([\d.]+) 15V([\d.]+)"\/>/g)].map(([, x, y]) => [Number(x), Number(y)]);
    const metre = lines[1][0] - lines[0][0];
    assert.ok(Math.abs(metre - 20) < 0.02, `${metre} mm a metre at 1 : 50`);
    const labels = [...text.matchAll(/<text x="([\d.]+)" y="[\d.]+">(-?\d+)</g)];
    const zero = Number(labels.find(([, , at]) => at === "0")[1]);
    const rows = [...text.matchAll(/translate\([\d.]+ ([\d.]+)\)rotate\(-90\)">(-?\d+)</g)];
    const ground = Number(rows.find(([, , at]) => at === "0")[1]);
    const outlines = [...attribute('path class="cut"', "d").matchAll(/M([^Z]*)Z/g)].map(([, corners]) =>
      corners.split("L").map((corner) => corner.split(" ").map(Number)),
    );
    // Even-odd: outlines that a ray to the right crosses.
    const isCut = ([x, y]) => {
      const [px, py] = [zero + x * metre, ground - y * metre];
      let crossed = 0;
      for (const corners of outlines) {
        corners.forEach(([ax, ay], n) => {
          const [bx, by] = corners[(n + 1) % corners.length];
          if (ay > py !== by > py && px < ax + ((py - ay) / (by - ay)) * (bx - ax)) crossed++;
        });
      }
      return crossed % 2 === 1;
    };
    // The wall between the rooms stands at x = 4.8 to 5, its door at y = 4.5 to 5.5.
    const wall = Array.from({ length: 60 }, (_, n) => 1.03 + n * 0.05);
    const faces = wall.filter((y) => isCut([4.825, y]) || isCut([4.775, y])).length;
    assert.ok(faces > 50, `${faces} of 60 places of the wall`);
    assert.ok(![4.65, 4.85, 5, 5.2, 5.35].some((y) => isCut([4.9, y]) || isCut([4.825, y])), "the door is open");
    assert.ok(![2, 2.5, 3].some((x) => isCut([x, 6.5])), "the room is empty");
  });

  it("lists what was measured and saves it as a table", async () => {
    await walkIn(page, address(server, { at: [8, 5, 0], look: [90, -40] }));
    await tool("Measure").click();
    const entries = page.locator(".measures li");
    for (let clicks = 0; (await entries.count()) < 2; clicks++) {
      assert.ok(clicks < 60, "two distances are measured");
      await page.mouse.click(middle.x + (clicks % 3) * 20, middle.y + (clicks % 2) * 120);
      await page.waitForTimeout(500);
    }
    const { name, text } = await savedText(page.getByRole("button", { name: "Save as CSV" }));
    assert.equal(name, "measures.csv");
    const [head, ...rows] = text.trimEnd().split("\r\n");
    assert.equal(head, "x0,y0,z0,x1,y1,z1,distance,distance_error,across,across_error,height,height_error");
    assert.equal(rows.length, 2);
    for (const row of rows) {
      const [x0, y0, z0, x1, y1, z1, distance, , across, , height] = row.split(",").map(Number);
      assert.ok(Math.abs(Math.hypot(x1 - x0, y1 - y0, z1 - z0) - distance) < 1e-3, row);
      assert.ok(Math.abs(Math.hypot(x1 - x0, y1 - y0) - across) < 1e-3 && Math.abs(z1 - z0 - height) < 1e-3, row);
    }
    await page.getByRole("button", { name: "Remove measure 1" }).click();
    assert.equal(await entries.count(), 1);
  });

  it("shows only what is inside the section box, and picks nothing outside", async () => {
    await walkIn(page, address(server, { at: WAY.start, view: "orbit" }));
    await drawn();
    await tool("Section").click();
    // A box around everything: roofs are not cut off any more.
    await page.getByRole("slider", { name: "East" }).fill("499");
    const { covered: whole } = await until(page, "all of the house before the eye", ({ covered }) => covered > 0.15);
    await page.getByRole("slider", { name: "East" }).fill("150");
    assert.ok(await page.getByLabel("Show only what is inside the box").isChecked());
    await until(page, "less than that", ({ covered }) => covered > 0 && covered < 0.7 * whole);
    // Sides do not cross.
    await page.getByRole("slider", { name: "West" }).fill("400");
    assert.equal(await page.getByRole("slider", { name: "West" }).inputValue(), "149");
    await page.getByRole("button", { name: "All of the scan" }).click();
    assert.equal(await page.getByLabel("Show only what is inside the box").isChecked(), false);
  });

  it("draws again after each change of what is shown", async () => {
    await walkIn(page, address(server, { at: WAY.start, view: "orbit" }));
    const draws = async (what, act) => {
      // A picture now; the next one comes by itself after 4 s.
      await page.evaluate(() => window.dispatchEvent(new Event("pageshow")));
      let [pictures, last] = [-1, -2];
      while (pictures !== last) {
        await page.waitForTimeout(500);
        [pictures, last] = [(await state(page)).pictures, pictures];
      }
      await act();
      await until(page, `drawn after ${what}`, (now) => now.pictures > pictures, { timeout: 2500 });
    };
    await tool("Colours").click();
    await draws("other colours", () => page.getByLabel("Slope", { exact: true }).check());
    await tool("Section").click();
    await draws("the section", () => page.getByRole("slider", { name: "East" }).fill("150"));
    await draws("the slices", () => tool("Slices").click());
    await draws("one slice", () => page.getByLabel("Show one slice only").check());
    await draws("another theme", () => page.emulateMedia({ colorScheme: "dark" }));
    await draws("another size", () => page.setViewportSize({ width: 700, height: 500 }));
    await draws("another view", () => page.keyboard.press("m"));
  });

  it("opens a file of this computer, dropped or chosen, without the network", async () => {
    await page.goto(server.address);
    const heading = page.getByRole("heading", { name: "Walk in a laser scan" });
    await heading.waitFor();
    // Without a scan, nothing to act on would remain.
    for (let n = 0; n < 2; n++) {
      await page.keyboard.press("Escape");
      await page.waitForTimeout(100);
      await heading.waitFor();
    }
    await page.locator("input[type=file]").setInputFiles(house());
    await until(page, "ready", ({ ready }) => ready);
    const { requests, bytesLoaded } = await state(page);
    assert.ok(requests > 0 && bytesLoaded > 0);
    await tool("Open another archive").click();
    await page.getByRole("button", { name: "Close" }).click();
    await heading.waitFor({ state: "hidden" });
    await page.keyboard.down("w");
    await until(page, "walking", ({ speed }) => speed > 0.5);
    await page.keyboard.up("w");
    await drop(page, "dropped.slices", readFileSync(house()));
    await page.getByRole("heading", { name: "dropped.slices", level: 1 }).waitFor();
    await until(page, "ready", ({ ready }) => ready);
  });

  it("saves a picture of what it shows", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [60, 0] }));
    await drawn();
    const [download] = await Promise.all([page.waitForEvent("download"), tool("Screenshot").click()]);
    assert.match(download.suggestedFilename(), /^slicewalk-.*\.png$/);
    const stream = await download.createReadStream();
    const picture = Buffer.concat(await stream.toArray());
    assert.ok(picture.length > 5_000 && picture.subarray(1, 4).toString() === "PNG", `${picture.length} bytes`);
  });

  it("takes another pawn, and refuses one that does not fit", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await tool("Settings").click();
    const speed = page.getByLabel("Walking speed (m/s)");
    await speed.fill("3");
    await speed.press("Enter");
    await page.locator("canvas.view").focus();
    await page.keyboard.down("w");
    await until(page, "faster", (now) => Math.abs(now.speed - 3) < 0.1);
    await page.keyboard.up("w");
    const [whole, field] = [(await state(page)).covered, page.getByLabel("Field of view (°)")];
    await field.fill("100");
    await until(page, "a wider view", ({ covered }) => covered !== whole);
    const height = page.getByLabel("Pawn height (m)");
    await height.fill("3.5");
    await height.press("Enter");
    await page.getByText("This pawn does not fit here").waitFor();
    await page.getByRole("button", { name: "Default settings" }).click();
    await until(page, "as before", () => true);
    assert.equal(await height.inputValue(), "1.8");
  });
});

describe("headset", () => {
  it("walks and turns by the controllers, and comes off again", async () => {
    await page.addInitScript(IWER);
    await page.addInitScript(() => {
      window.device = new window.IWER.XRDevice(window.IWER.metaQuest3);
      window.device.installRuntime({ forceInstall: true });
    });
    const { at: from } = await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    const worn = (pressed) => page.getByRole("button", { name: "Enter VR", pressed });
    await worn(false).click();
    await worn(true).waitFor();
    const stick = (hand, x, y) =>
      page.evaluate(([hand, x, y]) => window.device.controllers[hand].updateAxes("thumbstick", x, y), [hand, x, y]);
    await stick("left", 0, -1);
    await until(page, "a metre on", ({ at }) => at[1] - from[1] >= 1);
    await stick("left", 0, 0);
    await stick("right", 1, 0);
    await until(page, "turned by 30°", ({ look, speed }) => Math.abs(look[0] - 30) < 1 && speed === 0);
    await stick("right", 0, 0);
    await stick("left", 0, 0.8);
    await until(page, "walking back", ({ at }) => at[0] < from[0] - 0.2);
    await stick("left", 0, 0);
    // The emulator's picture covers the page.
    await worn(true).dispatchEvent("click");
    await worn(false).waitFor();
    const { frames } = await state(page);
    await until(page, "drawing on", (now) => now.frames > frames + 2);
  });
});

describe("for everyone", () => {
  it("has no serious fault that axe finds", async () => {
    const check = async (what) => {
      const results = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"] }));
      const serious = results.violations.filter(({ impact }) => impact === "serious" || impact === "critical");
      assert.deepEqual(
        serious.map(({ id, nodes }) => [id, nodes.map(({ target }) => target.join(" "))]),
        [],
        what,
      );
    };
    await page.addInitScript(AXE);
    await page.goto(server.address);
    await page.getByRole("heading", { name: "Walk in a laser scan" }).waitFor();
    await check("the welcome");
    await walkIn(page, address(server, { at: WAY.start, look: [60, 0] }));
    await check("walking");
    for (const name of ["Measure", "Slices", "Colours", "Settings"]) {
      await tool(name).click();
      await check(name);
    }
    await page.keyboard.press("h");
    await page.getByRole("heading", { name: "Keys and gestures" }).waitFor();
    await check("help");
  });

  it("has a favicon, names its archive, and reaches every tool by the keyboard", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    const icon = await page.locator("link[rel=icon]").getAttribute("href");
    const answer = await page.request.get(new URL(icon, server.address).href);
    assert.equal(answer.status(), 200);
    assert.match(await page.title(), /house\.slices/);
    const reached = new Set();
    for (let n = 0; n < 24; n++) {
      await page.keyboard.press("Tab");
      reached.add(await page.evaluate(() => document.activeElement?.textContent?.trim() ?? ""));
    }
    for (const name of ["Walk", "Orbit", "Plan", "Fly", "Measure", "Slices", "Settings", "Copy link", "Screenshot", "Help"]) {
      assert.ok(reached.has(name), `${name} is not among ${[...reached]}`);
    }
    await tool("Settings").click();
    await page.getByLabel("Walking speed (m/s)").focus();
    await page.keyboard.press("Escape");
    await page.locator(".right .panel:not([hidden])").waitFor({ state: "detached" });
    assert.equal(await page.evaluate(() => document.activeElement?.textContent), "Settings");
  });
});
