// Shares of the picture that archives fill in their first views, from outside and where one walks in, and pictures of both:
// `node views.js FOLDER ARCHIVE...`. A line for each archive; exit code 1 if one fills less than the page promises.

import { basename, join } from "node:path";
import { launch, state, until, walkIn } from "./browser.js";
import { DIST } from "./scans.js";
import { StaticServer } from "./static-server.js";
import { FRAMED, settled, WALKING } from "./steer.js";

const SIZE = { width: 1280, height: 720 };
const JPEG = { type: "jpeg", quality: 80 };

const [folder, ...archives] = process.argv.slice(2);
if (archives.length === 0) {
  console.error("usage: node views.js FOLDER ARCHIVE...");
  process.exit(2);
}
const server = await new StaticServer(DIST, Object.fromEntries(archives.map((path, n) => [`/${n}.slices`, path]))).start();
let browser = await launch();
const covers = (least) => (now) => now.covered >= least;

/** Share of the picture, which may grow for a while. */
async function share(page, least) {
  await settled(page);
  await until(page, "enough", covers(least), { timeout: 10_000 }).catch(() => {});
  return (await state(page)).covered;
}

async function views(n, name) {
  const page = await browser.newPage({ viewport: SIZE });
  try {
    await walkIn(page, `${server.address}?archive=${n}.slices`);
    const framed = await share(page, FRAMED);
    await page.screenshot({ path: join(folder, `${name}-framed.jpg`), ...JPEG });
    await page.getByRole("button", { name: "Walk in" }).click({ force: true });
    await until(page, "walking", ({ mode }) => mode === "walk");
    const walking = await share(page, WALKING);
    await page.screenshot({ path: join(folder, `${name}-walking.jpg`), ...JPEG });
    const { ground } = await state(page);
    return { framed, walking, ground };
  } finally {
    await page.end();
  }
}

let poor = 0;
for (const [n, path] of archives.entries()) {
  const name = basename(path, ".slices");
  try {
    const { framed, walking, ground } = await views(n, name);
    const isPoor = framed < FRAMED || walking < WALKING;
    poor += isPoor ? 1 : 0;
    console.log(`${framed.toFixed(2)}  ${walking.toFixed(2)}  ${ground.padEnd(7)}  ${name}${isPoor ? "  POOR" : ""}`);
  } catch (error) {
    poor += 1;
    console.log(`${name}: ${String(error).split("\n")[0]}`);
    await browser.close();
    browser = await launch();
  }
}
await browser.close();
await server.stop();
process.exit(poor > 0 ? 1 : 0);
