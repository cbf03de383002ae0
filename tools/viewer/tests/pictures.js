// Takes the viewer's pictures for the documentation: `node pictures.js FOLDER [NAME...]`, on a quiet machine. Needs
// SLICEWALK_DATA, the folder with the real scan of two storeys.

import { join } from "node:path";
import { launch, until, walkIn } from "./browser.js";
import { DIST, scanned, twoStoreys } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { address, settled } from "./steer.js";

const SIZE = { width: 1280, height: 720 };
const JPEG = { type: "jpeg", quality: 80 };
/** On the way to the stairs, looking along them. */
const STAIRS = { at: [-10.2, -4.35, -1.2], look: [275, -8] };

/** Opens a tool of the toolbar. */
const tool = (name) => (page) => page.getByRole("button", { name }).click();

/** Turns the wheel by `notches`, outwards if positive, and waits until everything visible has its colours. */
const coloured = (notches) => async (page) => {
  await page.mouse.move(SIZE.width / 2, SIZE.height / 2);
  for (let n = 0; n < Math.abs(notches); n++) await page.mouse.wheel(0, 200 * Math.sign(notches));
  await page.waitForTimeout(2000);
  const whole = ({ drawn, colours }) => drawn.coloured + drawn.distant > 0 && colours.missing === 0;
  await settled(page);
  await until(page, "coloured", whole, { timeout: 120_000 });
};

const PICTURES = [
  { name: "viewer-walk.jpg", place: STAIRS },
  { name: "viewer-orbit.jpg", place: { ...STAIRS, view: "orbit" } },
  { name: "viewer-plan.jpg", place: { ...STAIRS, view: "plan" } },
  { name: "viewer-slices.jpg", place: { ...STAIRS, view: "orbit" }, prepare: tool("Slices") },
  { name: "viewer-pump-room.jpg", place: { archive: "pump_room.slices", view: "orbit" }, prepare: coloured(0) },
  { name: "viewer-autzen.jpg", place: { archive: "autzen_stadium.slices", view: "orbit" }, prepare: coloured(0) },
];

const [folder, ...names] = process.argv.slice(2);
if (folder === undefined) {
  console.error("usage: node pictures.js FOLDER [NAME...]");
  process.exit(2);
}
const server = await new StaticServer(DIST, {
  "/indoor.slices": twoStoreys(),
  "/pump_room.slices": scanned("pump_room", "--pixel", "0.02"),
  "/autzen_stadium.slices": scanned("autzen_stadium", "--levels", "on"),
}).start();
const browser = await launch();
try {
  const wanted = PICTURES.filter(({ name }) => names.length === 0 || names.includes(name));
  for (const { name, place, prepare = async () => {} } of wanted) {
    const page = await browser.newPage({ viewport: SIZE });
    try {
      await walkIn(page, address(server, { archive: "indoor.slices", ...place }));
      await until(page, "the first steps", ({ drawn }) => drawn.pages > 0);
      await prepare(page);
      await settled(page);
      await page.screenshot({ path: join(folder, name), ...JPEG });
      console.log(name);
    } finally {
      await page.end();
    }
  }
} finally {
  await browser.close();
  await server.stop();
}
