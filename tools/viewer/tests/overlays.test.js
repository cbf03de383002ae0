// Gaussian splats over an archive: dropped or named by the address, aligned, and free of cost for pages without them.

import assert from "node:assert/strict";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, beforeEach, describe } from "node:test";
import { drop, hold, it, pages, pixels, state, until, walkIn } from "./browser.js";
import { DIST, house, WAY } from "./scans.js";
import { magentaCube } from "./splats.js";
import { StaticServer } from "./static-server.js";
import { address } from "./steer.js";

let server, page, folder;
const tests = pages();

before(async () => {
  folder = mkdtempSync(join(tmpdir(), "slicewalk-overlays-"));
  writeFileSync(join(folder, "cube.ply"), magentaCube());
  server = await new StaticServer(DIST, {
    "/house.slices": house(),
    "/cube.ply": join(folder, "cube.ply"),
  }).start();
});
after(async () => {
  await server?.stop();
  rmSync(folder, { recursive: true });
});
beforeEach(() => {
  server.requests.length = 0;
  page = tests.page;
});

/** Two metres ahead of the pawn at eye height. */
const AHEAD = [WAY.start[0], WAY.start[1] + 2, 1.65];
const view = () => address(server, { at: WAY.start, look: [0, 0] });
const chunk = () => server.requests.filter(({ path }) => /spark/.test(path));

/** Fraction of magenta pixels in the middle of the screen. */
async function magenta() {
  const seen = await pixels(page);
  return seen.filter(([r, g, b]) => r > 120 && b > 120 && g < 90).length / seen.length;
}

async function seen(what, fits) {
  const end = Date.now() + 60_000;
  for (let share = await magenta(); !fits(share); share = await magenta()) {
    if (Date.now() > end) throw new Error(`never ${what}: ${share} of the pixels`);
    await page.waitForTimeout(200);
  }
}

describe("Gaussian splats", () => {
  it("are drawn where the address puts them, and stay in its link", async () => {
    await walkIn(page, `${view()}&splats=cube.ply&align=${AHEAD.join(",")},30,1&up=-y`);
    await until(page, "drawn", ({ drawn }) => drawn.splats === 27);
    await seen("seen", (share) => share > 0.1);
    await page.getByRole("button", { name: "Copy link" }).click();
    await page.waitForURL(/splats=cube\.ply&align=1\.5,4,1\.65,30,1&up=-y/);
  });

  it("are dropped on the page and aligned by hand, and what draws them comes only then", async () => {
    await walkIn(page, view());
    assert.equal((await state(page)).drawn.splats, 0);
    assert.deepEqual(chunk(), []);
    await drop(page, "cube.ply", magentaCube());
    await page.getByText("Gaussian splats: 27 drawn.").waitFor();
    assert.equal(chunk().length, 1);
    await page.getByRole("button", { name: "Colours" }).click();
    const number = async (label, value) => {
      await page.getByLabel(label).fill(String(value));
      await page.getByLabel(label).press("Enter");
    };
    await number("Origin x (m)", AHEAD[0]);
    await number("Origin y (m)", AHEAD[1]);
    await number("Origin z (m)", AHEAD[2]);
    await seen("seen", (share) => share > 0.1);
    await number("Origin z (m)", AHEAD[2] + 50);
    await seen("gone", (share) => share === 0);
    await number("Origin z (m)", AHEAD[2]);
    await seen("back", (share) => share > 0.1);
    await page.getByLabel("The archive as well").uncheck();
    await seen("alone", (share) => share > 0.1);
    await page.getByLabel("Gaussian splats").uncheck();
    await seen("switched off", (share) => share === 0);
    assert.equal((await state(page)).drawn.splats, 0);
  });

  it("are saved as they are shown, without the finish of the archive", async () => {
    await page.addInitScript(() => localStorage.setItem("slicewalk.settings", JSON.stringify({ quality: 2 })));
    const at = address(server, { at: WAY.start, look: [60, 0] });
    await walkIn(page, `${at}&splats=cube.ply&align=${AHEAD.join(",")},30,1&up=-y`);
    await until(page, "drawn", ({ drawn }) => drawn.splats === 27);
    const saved = async () => {
      const save = page.getByRole("button", { name: "Screenshot" });
      const [download] = await Promise.all([page.waitForEvent("download"), save.click()]);
      const bytes = [...Buffer.concat(await (await download.createReadStream()).toArray())];
      return page.evaluate(async (bytes) => {
        const image = await createImageBitmap(new Blob([new Uint8Array(bytes)]));
        const [w, h] = [image.width, image.height];
        const context = new OffscreenCanvas(w, h).getContext("2d");
        context.drawImage(image, 0, 0);
        const { data } = context.getImageData(w / 4, h / 3, w / 4, h / 3);
        return Array.from({ length: Math.ceil(data.length / 28) }, (_, n) => [...data.subarray(28 * n, 28 * n + 3)]);
      }, bytes);
    };
    // Pages may arrive between the two pictures.
    const end = Date.now() + 30_000;
    for (let share = 1; share > 0.002;) {
      assert.ok(Date.now() < end, `${share} of the pixels differ`);
      const [picture, screen] = [await saved(), await pixels(page)];
      share = picture.filter((rgb, n) => rgb.some((value, c) => Math.abs(value - screen[n][c]) > 8)).length / picture.length;
    }
  });

  it("that cannot be read are refused in words, and the walk goes on", async () => {
    await walkIn(page, view());
    await drop(page, "broken.ply", Buffer.from("ply\nproperty float f_dc_0\nend_header\n"));
    await page.getByText(/The splats cannot be drawn: /).waitFor();
    await hold(page, ["w"], "walking", ({ speed }) => speed > 0.5);
    // The splat reader logs the error on the console too.
    const others = page.complaints.filter((text) => !text.includes("Property outside of element"));
    page.complaints.splice(0, Infinity, ...others);
  });
});
