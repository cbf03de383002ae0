// The first view: all of the scan, then the place where most of it is seen.

import assert from "node:assert/strict";
import { after, before, beforeEach, describe } from "node:test";
import { it, pages, state, until, walkIn } from "./browser.js";
import { DIST, house, scanned, scannedFile, twoStoreys, WAY } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { address, FRAMED, WALKING } from "./steer.js";

const PATIENT = { timeout: 110_000 };

let server, page;
const tests = pages();
const data = process.env.SLICEWALK_DATA;

before(async () => {
  const files = { "/house.slices": house() };
  if (data) {
    files["/indoor.slices"] = twoStoreys();
    files["/sparse.slices"] = scannedFile("formats/made/pump_three_stations_poses.e57", "--units", "m", "--levels", "on");
    for (const name of ["pump_room", "delft_city_block_ahn3", "corridor_three_stations"])
      files[`/${name}.slices`] = scanned(name);
  }
  server = await new StaticServer(DIST, files).start();
});
after(async () => {
  await server?.stop();
});
beforeEach(() => {
  page = tests.page;
});

const button = () => page.getByRole("button", { name: "Walk in" });

/** What a place of a small sparse scan shows at least: from its edge it was a fifth. */
const SPARSE = 0.35;

async function covers(archive, walking = WALKING) {
  await walkIn(page, `${server.address}?archive=${archive}`);
  const { mode } = await until(page, "framed", ({ covered }) => covered >= FRAMED, PATIENT);
  assert.equal(mode, "orbit");
  // Software graphics draw so few frames that a check for a still button takes long.
  await button().click({ force: true });
  await until(page, "walking with the scan before the eyes", (now) => now.mode === "walk" && now.covered >= walking, PATIENT);
  assert.ok(!(await button().isVisible()));
}

describe("the first view", () => {
  it("shows all of the house, names it, and walks in where most is seen", async () => {
    await covers("house.slices");
    const { at, ground } = await until(page, "standing", (now) => now.ground === "walking" && now.speed === 0);
    assert.ok(at[0] > 0 && at[0] < 14 && at[1] > 0 && at[1] < 10, `${at}, ${ground}`);
  });

  it("names the scan and its size, and goes in by a key that walks", async () => {
    await walkIn(page, `${server.address}?archive=house.slices`);
    await page.getByRole("heading", { name: "house.slices", level: 2 }).waitFor();
    await page.getByText(/^\d+\.\d × \d+\.\d × \d+\.\d m$/).waitFor();
    const { frames } = await state(page);
    await until(page, "frames", (now) => now.frames > frames + 3);
    // A slow frame reads only keys that are still down.
    await page.keyboard.down("w");
    await until(page, "walking", ({ mode }) => mode === "walk");
    await page.keyboard.up("w");
  });

  it("is skipped by addresses that name a place", async () => {
    await walkIn(page, address(server, { at: WAY.start }));
    assert.equal((await state(page)).mode, "walk");
    assert.ok(!(await button().isVisible()));
  });

  for (const archive of ["indoor", "pump_room", "delft_city_block_ahn3"]) {
    it(`shows enough of ${archive}`, { skip: data ? false : "SLICEWALK_DATA is not set" }, () => covers(`${archive}.slices`));
  }

  const ways = { de: "Hineingehen", fr: "Entrer", es: "Entrar", pt: "Entrar" };
  for (const [language, way] of Object.entries(ways)) {
    it(`speaks ${language}`, async () => {
      await page.goto(`${server.address}?archive=house.slices&lang=${language}`);
      await page.getByRole("button", { name: way }).waitFor();
      assert.equal(await page.locator("html").getAttribute("lang"), language);
    });
  }

  it("begins within a corridor, not beside it or on it", { skip: data ? false : "SLICEWALK_DATA is not set" }, async () => {
    await covers("corridor_three_stations.slices");
    const { at } = await state(page);
    assert.ok(at[2] < 0.5, `it stands at ${at}, the floor is at -0.6 m and the roof at 2 m`);
  });

  it(
    "begins in a small sparse scan where its points are, not where wide rays meet any",
    { skip: data ? false : "SLICEWALK_DATA is not set" },
    () => covers("sparse.slices", SPARSE),
  );
});
