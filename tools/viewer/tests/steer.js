// Walks by keys: looks towards a place and holds W until it is reached.

import { hold, state, walkIn } from "./browser.js";

export const NEAR = 0.35;

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

/** Runs eastwards over a link of 20 Mbit/s and 40 ms: bytes loaded, and how many pages a frame missed at most. */
export async function runAlong(page, server, archive, metres) {
  Object.assign(server, { delayMs: 40, bytesPerSecond: 2_500_000 });
  const { at: from } = await walkIn(page, address(server, { archive, at: [2, 0, 0.1], look: [90, 0] }));
  await page.evaluate(() => {
    window.waited = 0;
    const look = () => {
      window.waited = Math.max(window.waited, window.slicewalk.state().missing);
      requestAnimationFrame(look);
    };
    look();
  });
  const { bytesLoaded } = await hold(page, ["Shift", "w"], `${metres} m on`, ({ at }) => at[0] > from[0] + metres, {
    timeout: 120_000,
  });
  return { bytesLoaded, waited: await page.evaluate(() => window.waited) };
}
