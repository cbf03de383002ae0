// Getting about, and what browsers, devices and people do wrong on the way.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { after, before, beforeEach, describe } from "node:test";
import { drop, hold, it, pages, state, until, walkIn } from "./browser.js";
import { DIST, house, other, WAY } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { address } from "./steer.js";

let server, page;
const tests = pages();
const middle = { x: 400, y: 250 };
const tool = (name) => page.getByRole("button", { name, exact: false });
/** Screens of phones, upright and on their side. */
const PHONES = [
  [390, 844],
  [320, 568],
  [844, 390],
  [640, 360],
];
const near = (a, b, far = 0.3) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]) < far;

before(async () => {
  server = await new StaticServer(DIST, { "/house.slices": house(), "/other.slices": other() }).start();
});
after(async () => {
  await server?.stop();
});
beforeEach(() => {
  page = tests.page;
});

describe("getting about", () => {
  it("brings a pawn back that fell out of the world", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    await until(page, "standing", ({ ground, speed }) => ground === "walking" && speed === 0);
    await page.waitForTimeout(1500);
    await page.evaluate(() => void window.slicewalk.goto({ at: [-40, -40, 0] }).catch(() => {}));
    await page.getByText("You fell out of the scan").waitFor();
    await until(page, "back", ({ at, ground }) => near(at, WAY.start) && ground === "walking");
  });

  it("returns to the start by Home, and to the last safe place by R", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await until(page, "standing", ({ ground, speed }) => ground === "walking" && speed === 0);
    await page.waitForTimeout(1500);
    await hold(page, ["w"], "a metre on", ({ at }) => at[1] > WAY.start[1] + 1.2);
    const { at } = await until(page, "standing", ({ speed }) => speed === 0);
    await page.keyboard.press("r");
    await until(page, "back a little", (now) => near(now.at, WAY.start, 2.5) && !near(now.at, at));
    await page.evaluate((place) => window.slicewalk.goto({ at: place }), [4, 5, 0]);
    await page.keyboard.press("Home");
    await until(page, "at the start", (now) => near(now.at, WAY.start));
    await page.keyboard.press("Home");
    await until(page, "all of the scan", ({ mode }) => mode === "orbit");
    await tool("Walk in").waitFor();
  });

  it("flies faster by the wheel", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await page.keyboard.press("f");
    await page.mouse.move(middle.x, middle.y);
    await page.mouse.wheel(0, -400);
    await hold(page, ["w"], "fast", ({ speed }) => speed > 4 * 1.4 + 0.5);
  });

  it("says at the crosshair why it stops", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [270, 0] }));
    await page.keyboard.down("w");
    await page.locator(".stop").getByText("A wall, or a step that is too high").waitFor();
    await page.keyboard.up("w");
    await hold(page, ["s"], "walking", ({ speed }) => speed > 0.5);
    await page.locator(".stop").waitFor({ state: "hidden" });
  });

  it("goes where the map is clicked", async () => {
    const { at } = await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    const map = page.locator(".map canvas");
    await page.waitForTimeout(1500);
    const box = await map.boundingBox();
    // 24 m across, north up: 2 m to the north.
    await map.click({ position: { x: box.width / 2, y: box.height / 2 - (2 / 24) * box.height } });
    await until(page, "there", (now) => Math.abs(now.at[1] - at[1] - 2) < 0.4 && Math.abs(now.at[0] - at[0]) < 0.4);
  });
});

describe("odd devices", () => {
  it("walks on a host that does not permit gamepads", async () => {
    await page.addInitScript(() => {
      navigator.getGamepads = () => {
        throw new DOMException('Access to the feature "gamepad" is disallowed by permissions policy.', "SecurityError");
      };
    });
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await hold(page, ["w"], "walking", ({ speed }) => speed > 0.5);
    assert.equal((await state(page)).error, null);
  });

  it("ignores devices without the standard layout", async () => {
    await page.addInitScript(() => {
      const stick = { connected: true, mapping: "", axes: [0, 0, -1, 0, 0, -1], buttons: [] };
      navigator.getGamepads = () => [stick, null, null, null];
    });
    await walkIn(page, address(server, { at: WAY.start, look: [90, 0] }));
    const { frames } = await state(page);
    const { look } = await until(page, "frames", (now) => now.frames > frames + 8);
    assert.deepEqual(look, [90, 0]);
  });

  it("draws with the pixels of the screen that it is moved to", async () => {
    // Where graphics are slow, a view that moves has fewer pixels.
    await page.addInitScript(() => localStorage.setItem("slicewalk.settings", JSON.stringify({ quality: 2 })));
    await walkIn(page, address(server, { at: WAY.start }));
    const width = () => page.evaluate(() => document.querySelector("canvas.view").width);
    const before = await width();
    const browser = await page.context().newCDPSession(page);
    const screen = { width: 800, height: 500, deviceScaleFactor: 2, mobile: false };
    await browser.send("Emulation.setDeviceMetricsOverride", screen);
    for (const end = Date.now() + 20_000; (await width()) !== 2 * before; await page.waitForTimeout(50)) {
      assert.ok(Date.now() < end, `${await width()} pixels, ${before} before`);
    }
  });

  it("captures the mouse again after the browser refused once", async () => {
    await page.addInitScript(() => {
      window.asked = 0;
      const request = HTMLCanvasElement.prototype.requestPointerLock;
      HTMLCanvasElement.prototype.requestPointerLock = function (...args) {
        window.asked += 1;
        return window.asked === 1 ? Promise.reject(new DOMException("not now", "NotAllowedError")) : request.apply(this, args);
      };
    });
    const { at } = await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await page.mouse.click(middle.x, middle.y);
    await page.waitForFunction(() => window.asked === 1);
    await page.waitForTimeout(1500);
    assert.ok(near((await state(page)).at, at, 0.05));
    await page.mouse.click(middle.x, middle.y);
    await page.waitForFunction(() => document.pointerLockElement !== null);
    assert.equal(await page.evaluate(() => window.asked), 2);
    await page.evaluate(() => document.exitPointerLock());
  });

  for (const [width, height] of PHONES) {
    it(`covers nothing on a screen of ${width} × ${height}, and has targets for fingers`, async () => {
      const phone = await tests.browser.newPage({ viewport: { width, height }, hasTouch: true, isMobile: true });
      try {
        for (const view of ["plan", "walk"]) {
          await walkIn(phone, address(server, { at: WAY.start, view }));
          await phone.locator(view === "plan" ? ".plan-bar" : ".storeys").waitFor();
          assert.deepEqual(await phone.evaluate(crossing), [], `nothing lies over something else in ${view}`);
        }
        for (const name of ["Settings", "Colours", "Slices", "Section", "Measure"]) {
          const button = phone.getByRole("button", { name, exact: true });
          await button.tap();
          const panel = phone.locator(".right .panel:not([hidden])");
          await panel.waitFor();
          assert.deepEqual(await phone.evaluate(unreachable), [], name);
          const { height: shown } = await phone.locator(".right:not(.stick)").boundingBox();
          assert.ok(shown > 200, `${name} shows ${shown} pixels`);
          await button.tap();
          await panel.waitFor({ state: "hidden" });
        }
        assert.deepEqual(phone.complaints, []);
      } finally {
        await phone.end();
      }
    });
  }
});

/** Pairs of parts of the page that lie over one another. */
function crossing() {
  const parts = [
    ".name",
    ".modes",
    ".tools",
    ".plan-bar",
    ".status",
    ".storeys",
    ".map",
    ".jump",
    ".stick.left",
    ".stick.right",
  ];
  const shown = parts
    .map((selector) => [selector, document.querySelector(selector)])
    .filter(([, element]) => element !== null && element.offsetParent !== null)
    .map(([selector, element]) => [selector, element.getBoundingClientRect()]);
  const outside = ({ left, top, right, bottom }) => left < 0 || top < 0 || right > innerWidth || bottom > innerHeight;
  const crosses = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  return shown.flatMap(([one, a], n) => [
    ...(outside(a) ? [`${one} and the edge`] : []),
    ...shown.slice(n + 1).flatMap(([other, b]) => (crosses(a, b) ? [`${one} and ${other}`] : [])),
  ]);
}

/** Buttons and fields that lie below something else where they are scrolled to, and buttons too small for fingers. */
function unreachable() {
  const shown = (selector) => [...document.querySelectorAll(selector)].filter((element) => element.offsetParent !== null);
  const buttons = shown(".head button");
  const fields = shown(".right .panel:not([hidden]) :is(input, select, button)");
  const hits = (element) => {
    element.scrollIntoView({ block: "nearest", inline: "nearest" });
    const { left, top, width, height } = element.getBoundingClientRect();
    const found = document.elementFromPoint(left + width / 2, top + height / 2);
    return element === found || element.contains(found) || found?.closest(".right") !== null;
  };
  const small = buttons.filter((button) => Math.min(button.offsetWidth, button.offsetHeight) < 44);
  return [...buttons, ...fields]
    .filter((element) => !hits(element))
    .concat(small)
    .map((element) => element.outerHTML);
}

describe("wrong files and addresses", () => {
  it("keeps the open archive when a wrong file is dropped", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await drop(
      page,
      "wrong.slices",
      Buffer.from("no archive at all, but long enough to be read as the head of one".repeat(40)),
    );
    const dialog = page.getByRole("dialog", { name: "This is not a slice archive" });
    await dialog.waitFor();
    await dialog.getByRole("button", { name: "Stay here" }).click();
    const { ready, error } = await state(page);
    assert.deepEqual([ready, error], [true, null]);
    await page.getByRole("heading", { name: "house.slices", level: 1 }).waitFor();
    // Nor does a wrong address in the history stop the walk.
    await page.evaluate(() => {
      history.replaceState(null, "", "?archive=http://");
      window.dispatchEvent(new PopStateEvent("popstate"));
    });
    await page.getByRole("dialog", { name: "The request is invalid" }).getByRole("button", { name: "Stay here" }).click();
    await hold(page, ["w"], "walking on", ({ speed }) => speed > 0.5);
  });

  it("opens a file whose name looks like a broken address", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    await drop(page, "50%.slices", readFileSync(house()));
    await page.getByRole("heading", { name: "50%.slices", level: 1 }).waitFor();
    await until(page, "ready", ({ ready, error }) => ready && error === null);
  });

  it("keeps the name of a file as it is, and saves it under that name", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    await drop(page, "house #1 50%?.slices", readFileSync(house()));
    await page.getByRole("heading", { name: "house #1 50%?.slices", level: 1 }).waitFor();
    const saving = page.waitForEvent("download");
    await page.getByRole("button", { name: "Save archive" }).click();
    assert.match((await saving).suggestedFilename(), /^house #1 50%.\.slices$/);
  });

  it("looks ahead where an address names a direction that is none", async () => {
    await page.goto(address(server, { at: WAY.start, look: [-90, 1000] }));
    const { look } = await until(page, "ready", ({ ready }) => ready);
    assert.deepEqual(look, [270, 89]);
  });

  it("finds a place to stand where an address names one outside the scan", async () => {
    await walkIn(page, address(server, { at: [500, 500, 2] }));
    await until(page, "on a floor", ({ ground, at }) => ground === "walking" && at[0] < 14 && at[1] < 10, { timeout: 60_000 });
  });

  it("names an address that is none", async () => {
    await page.goto(`${server.address}?archive=http://`);
    const { error } = await until(page, "an error", (now) => now.error !== null);
    assert.match(error, /no address/);
    const other = page.getByRole("dialog").getByRole("button", { name: "Open another archive" });
    await other.waitFor();
    // Who closes the message finds the choice, not an empty page.
    await page.keyboard.press("Escape");
    await page.getByRole("heading", { name: "Walk in a laser scan" }).waitFor();
    await page.goto(`${server.address}?archive=http://&kiosk=60`);
    await page.getByRole("dialog").getByText("http:// is no address").waitFor();
    assert.equal(await other.count(), 0);
  });

  it("keeps what was opened in the address, and goes back to the one before", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    const choose = async (name) => {
      await page.getByRole("button", { name: "Open another archive" }).click();
      await page.getByLabel("Address of an archive").fill(name);
      await page.getByRole("button", { name: "Open", exact: true }).click();
    };
    // What a slow host answers comes too late once something else is chosen.
    let answer;
    server.until = new Promise((resolve) => (answer = resolve));
    await choose("slow.laz");
    while (server.of("slow.laz").length === 0) await page.waitForTimeout(20);
    server.until = null;
    await choose("other.slices");
    await page.getByRole("heading", { name: "other.slices", level: 1 }).waitFor();
    await page.waitForURL(/archive=other\.slices/);
    answer();
    await page.waitForTimeout(1500);
    assert.equal(await page.getByRole("dialog").count(), 0);
    await page.goBack();
    await page.getByRole("heading", { name: "house.slices", level: 1 }).waitFor();
    await until(page, "ready", ({ ready, at }) => ready && near(at, WAY.start));
  });
});
