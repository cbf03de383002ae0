// Failures: graphics lost, host unreachable, archive replaced or damaged, wrong address.

import assert from "node:assert/strict";
import { copyFileSync, mkdtempSync, readFileSync, renameSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { beforeEach, describe } from "node:test";
import { hold, it, pages, state, until, walkIn } from "./browser.js";
import { colouredHouse, DIST, house, other, WAY } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { address } from "./steer.js";

let page, server, folder;
/** How saving the open archive ends. */
const saved = () =>
  page.evaluate(() =>
    window.slicewalk.save().then(
      ({ size }) => size,
      ({ kind }) => kind,
    ),
  );
const tests = pages({
  network: false,
  async begin() {
    folder = mkdtempSync(join(tmpdir(), "slicewalk-trouble-"));
    copyFileSync(house(), join(folder, "house.slices"));
    server = await new StaticServer(DIST, {
      "/house.slices": join(folder, "house.slices"),
      "/bad.slices": join(folder, "bad.slices"),
    }).start();
  },
  async end() {
    await server?.stop();
    rmSync(folder, { recursive: true });
  },
});

beforeEach(() => {
  page = tests.page;
});

describe("trouble", () => {
  it("survives the loss of its graphics", async () => {
    await walkIn(page, address(server, { at: WAY.start, look: [60, 0] }));
    const picture = () => page.locator("canvas.view").screenshot();
    await page.waitForTimeout(1500);
    await page.evaluate(() => {
      const lose = document.querySelector("canvas.view").getContext("webgl2").getExtension("WEBGL_lose_context");
      Object.assign(window, { lose });
      lose.loseContext();
    });
    await page.getByText("The graphics were lost").waitFor();
    const black = await picture();
    await page.evaluate(() => window.lose.restoreContext());
    await page.getByText("The graphics are back").waitFor();
    await hold(page, ["w"], "walking on", ({ speed }) => speed > 0.5);
    for (const end = Date.now() + 60_000; (await picture()).length <= 1.5 * black.length;) {
      assert.ok(Date.now() < end, "nothing is drawn after the graphics came back");
    }
    // Objects of the lost context are deleted in the new one, which logs a warning.
    const others = page.complaints.filter((text) => !text.includes("does not belong to this context"));
    page.complaints.splice(0, Infinity, ...others);
  });

  it("waits for a host that went away, and goes on when it is back", async () => {
    // Slow enough that the third storey is not loaded when the host disappears.
    server.delayMs = 500;
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    await server.stop();
    assert.equal(await saved(), "network");
    await page.evaluate(() => void window.slicewalk.goto({ at: [9.25, 4.5, 6.2] }).catch(() => {}));
    await until(page, "waiting for pages", ({ missing, at }) => missing > 0 && at[2] > 6);
    await page.getByText("Connection trouble, trying again").waitFor();
    server.delayMs = 0;
    await server.start();
    await until(page, "on the floor of the third storey", ({ at, missing }) => Math.abs(at[2] - 6) < 0.05 && missing === 0, {
      timeout: 120_000,
    });
    assert.equal((await state(page)).error, null);
  });

  it("says that an archive was replaced, and opens the new one", async () => {
    // Slow enough that the next pages come from the new file.
    server.delayMs = 500;
    await walkIn(page, address(server, { at: WAY.start, look: [0, 0] }));
    copyFileSync(other(), join(folder, "new.slices"));
    renameSync(join(folder, "new.slices"), join(folder, "house.slices"));
    assert.equal(await saved(), "replaced");
    await page.evaluate(() => void window.slicewalk.goto({ at: [9.25, 4.5, 6.2] }).catch(() => {}));
    const dialog = page.getByRole("dialog", { name: "The archive was replaced while you walked" });
    await dialog.waitFor();
    assert.match((await state(page)).error, /replaced/);
    await dialog.getByRole("button", { name: "Open again" }).click();
    await until(page, "ready again", ({ ready, error }) => ready && error === null);
  });

  it("begins a kiosk again at its start, and leaves no other way", async () => {
    server.delayMs = 500;
    await walkIn(page, `${address(server, { at: WAY.start, look: [0, 0] })}&kiosk=60`);
    copyFileSync(other(), join(folder, "new.slices"));
    renameSync(join(folder, "new.slices"), join(folder, "house.slices"));
    await page.evaluate(() => void window.slicewalk.goto({ at: [9.25, 4.5, 6.2] }).catch(() => {}));
    const dialog = page.getByRole("dialog", { name: "The archive was replaced while you walked" });
    await dialog.waitFor();
    server.delayMs = 0;
    await page.keyboard.press("Escape");
    await page.waitForTimeout(500);
    await dialog.getByRole("button", { name: "Open again" }).click({ timeout: 5000 });
    const { at } = await until(page, "ready again", ({ ready, error }) => ready && error === null);
    assert.ok(Math.hypot(at[0] - WAY.start[0], at[1] - WAY.start[1]) < 1, `${at}`);
  });

  for (const [what, content, title] of [
    ["a web page", "<!doctype html><title>Not found</title>", "This is not a slice archive"],
    ["nothing", "", "This is not a slice archive"],
  ]) {
    it(`names ${what} where an archive should be, and offers another`, async () => {
      writeFileSync(join(folder, "bad.slices"), content);
      await page.goto(address(server, { archive: "bad.slices" }));
      const dialog = page.getByRole("dialog", { name: title });
      await dialog.waitFor();
      assert.equal((await state(page)).ready, false);
      await dialog.getByRole("button", { name: "Open another archive" }).click();
      await page.getByRole("heading", { name: "Walk in a laser scan" }).waitFor();
    });
  }

  it("names damage, never walks in it", async () => {
    const bytes = readFileSync(house());
    bytes.fill(0x55, 1000, bytes.length - 1000);
    writeFileSync(join(folder, "bad.slices"), bytes);
    await page.goto(address(server, { archive: "bad.slices", at: WAY.start }));
    const { error } = await until(page, "an error", (now) => now.error !== null);
    assert.match(error, /damaged/);
    await page.getByRole("dialog").getByText("slicetool verify").waitFor();
  });

  it("hatches what it cannot read in a saved plan", async () => {
    const bytes = readFileSync(house());
    // The end of all pages: the last one, at the corner that is farthest from the start.
    bytes[bytes.readUInt32LE(12) + Number(bytes.readBigUInt64LE(288)) - 1] ^= 1;
    writeFileSync(join(folder, "bad.slices"), bytes);
    const plan = async (archive) => {
      await walkIn(page, address(server, { archive, at: WAY.start, view: "plan" }));
      const save = page.getByRole("button", { name: "Save as SVG" });
      const [download] = await Promise.all([page.waitForEvent("download"), save.click()]);
      const text = Buffer.concat(await (await download.createReadStream()).toArray()).toString("utf8");
      return { hatched: /<path class="unknown"[^>]* d="M/.test(text), said: text.includes(" · hatched: not read\n") };
    };
    assert.deepEqual(await plan("bad.slices"), { hatched: true, said: true });
    assert.deepEqual(await plan("house.slices"), { hatched: false, said: false });
  });

  it("says once that colours are damaged, and walks on without them", async () => {
    const bytes = readFileSync(colouredHouse());
    const number = (at) => Number(bytes.readBigUInt64LE(at));
    // The end of pages, colours and levels, minus the levels and the table of colour leaves: the last of these leaves.
    const end = bytes.readUInt32LE(12) + number(288) - number(328);
    bytes[end - 12 * bytes.readUInt32LE(320) - 1] ^= 1;
    writeFileSync(join(folder, "bad.slices"), bytes);
    await walkIn(page, address(server, { archive: "bad.slices", at: WAY.start, look: [0, -30] }));
    await page.getByText("A part of this archive is damaged").waitFor();
    await page.getByText(/rule K3: colour leaf 0/).waitFor();
    await hold(page, ["w"], "walking on", ({ speed }) => speed > 0.5);
    const { error, drawn } = await until(page, "shapes without colours", ({ colours }) => colours.missing > 0);
    assert.deepEqual([error, drawn.coloured], [null, 0]);
    assert.equal(await page.getByText("Connection trouble").count(), 0);
  });

  it("says what a missing archive's address was answered", async () => {
    await page.goto(address(server, { archive: "missing.slices" }));
    const { error } = await until(page, "an error", (now) => now.error !== null);
    assert.match(error, /404/);
  });
});
