// Walks by keys: looks towards a place and holds W until the pawn reaches it.

import { hold, state, walkIn } from "./browser.js";
import { WAY } from "./scans.js";

export const NEAR = 0.35;

/** Least shares of the first picture, and of the first one while walking, that show the scan. */
export const FRAMED = 0.25;
export const WALKING = 0.5;

export async function lookTowards(page, [x, y]) {
  const { at } = await state(page);
  const heading = (Math.atan2(x - at[0], y - at[1]) * 180) / Math.PI;
  await page.evaluate((look) => window.slicewalk.goto({ look }), [heading, 0]);
}

/** Holds W until the pawn is near the place, and corrects its heading on the way. */
export async function walkTowards(page, place, { keys = ["w"], near = NEAR } = {}) {
  const turning = setInterval(() => void lookTowards(page, place).catch(() => {}), 250);
  try {
    await lookTowards(page, place);
    return await hold(page, keys, `at ${place}`, ({ at }) => Math.hypot(at[0] - place[0], at[1] - place[1]) < near, {
      timeout: 90_000,
    });
  } finally {
    clearInterval(turning);
  }
}

export const address = (server, { archive = "house.slices", at = null, look = null, view = null } = {}) => {
  const fields = [`archive=${archive}`];
  if (at) fields.push(`at=${at.join(",")}`);
  if (look) fields.push(`look=${look.join(",")}`);
  if (view) fields.push(`view=${view}`);
  return `${server.address}?${fields.join("&")}`;
};

/** The link for walks in scans: 20 Mbit/s, and 40 ms before each answer. */
export const LINK = { delayMs: 40, bytesPerSecond: 2_500_000 };

/**
 * Watches the page from now on, frame by frame: number of frames that missed a page, most pages missed by a frame, most
 * bytes of pages, and the tasks of the main thread that took 50 ms or longer.
 */
export function watch(page) {
  return page.evaluate(() => {
    const seen = { frames: 0, missed: 0, waited: 0, bytes: 0, tasks: [] };
    window.seen = seen;
    const observer = new PerformanceObserver((list) => seen.tasks.push(...list.getEntries().map(({ duration }) => duration)));
    observer.observe({ type: "longtask" });
    const look = () => {
      const { missing, pages } = window.slicewalk.state();
      seen.frames += 1;
      seen.missed += missing > 0 ? 1 : 0;
      seen.waited = Math.max(seen.waited, missing);
      seen.bytes = Math.max(seen.bytes, pages.bytes);
      requestAnimationFrame(look);
    };
    look();
  });
}

export const watched = (page) => page.evaluate(() => window.seen);

/** Runs eastwards from a place over that link; returns the watched values and the bytes loaded. */
export async function runAlong(page, server, archive, metres, from = [2, 0, 0.1]) {
  Object.assign(server, LINK);
  const { at } = await walkIn(page, address(server, { archive, at: from, look: [90, 0] }));
  await watch(page);
  const { bytesLoaded } = await hold(page, ["Shift", "w"], `${metres} m on`, (now) => now.at[0] > at[0] + metres, {
    timeout: 120_000,
  });
  return { bytesLoaded, ...(await watched(page)) };
}

/**
 * Requests for a house's archive before the pawn's first step: ranges, their bytes, and the page's count of colours.
 */
export async function firstStep(page, server, archive) {
  // The key is down from the beginning, pressed by the page itself, which also notes when it saw the first step: from
  // here both would come late on a busy machine.
  await page.addInitScript((y) => {
    let [pressed, early] = [false, false];
    const look = () => {
      const now = window.slicewalk?.state();
      if (now && !pressed) {
        const key = { code: "KeyW", key: "w", bubbles: true };
        (document.querySelector("canvas") ?? document.body).dispatchEvent(new KeyboardEvent("keydown", key));
        pressed = true;
      }
      early ||= now?.colours.requests > 0 && (now.missing > 0 || now.pages.resident === 0);
      if (now?.at[1] > y) window.firstStep = { at: Date.now(), early };
      else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  }, WAY.start[1]);
  await page.goto(address(server, { archive, at: WAY.start, look: [0, 0] }));
  await page.waitForFunction(() => window.firstStep !== undefined);
  const { at: step, early } = await page.evaluate(() => window.firstStep);
  const asked = server.of(archive).filter(({ at }) => at <= step);
  const bytes = asked.reduce((sum, request) => sum + request.bytes, 0);
  return { bytes, ranges: asked.map(({ range }) => range), early };
}

/** Frames and time (ms) without anything new after which a picture counts as complete, whatever the graphics' speed. */
const QUIET_FRAMES = 12;
const QUIET_MS = 2000;

/** Waits until nothing new arrives. */
export const settled = (page) =>
  page.evaluate(
    async ([quiet, quietMs]) => {
      let [last, frames, since] = ["", 0, 0];
      while (frames < quiet || performance.now() - since < quietMs) {
        await new Promise(requestAnimationFrame);
        const { drawn, pages, bytesLoaded, colours } = window.slicewalk.state();
        const now = JSON.stringify([drawn, pages, bytesLoaded, colours]);
        [frames, since] = now === last ? [frames + 1, since] : [0, performance.now()];
        last = now;
      }
    },
    [QUIET_FRAMES, QUIET_MS],
  );
