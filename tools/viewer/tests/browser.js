// Headless Chromium, and pages that fail a test when the page itself throws or logs an error or warning.
//
// Every test ends: all that a test opened is closed however it ends, a page that stops answering ends its file's
// browser (and so the remaining tests of the file, at once), and no test takes longer than `LIMIT_MS`.

import assert from "node:assert/strict";
import { existsSync } from "node:fs";
import * as node from "node:test";
import { chromium } from "playwright-core";

const ARGUMENTS = [
  "--no-sandbox",
  "--use-gl=angle",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
  "--ignore-gpu-blocklist",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];

export const CHROMIUM =
  process.env.CHROMIUM ?? ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find(existsSync);

/** Time after which a test fails. */
const LIMIT_MS = 150_000;
/** Time after which a silent page counts as hung, and the interval of the checks. */
const HUNG_MS = 30_000;
const ASKED_MS = 5_000;
/** Time after which a browser that does not close is killed. */
const CLOSE_MS = 10_000;

/** Like node's `it`, with a time limit. */
export function it(name, ...rest) {
  const test = rest.pop();
  node.it(name, { timeout: LIMIT_MS, ...rest[0] }, test);
}

/** Result of the promise, or a failure after `ms`. */
async function within(ms, what, promise) {
  let timer;
  const late = new Promise((_, reject) => {
    timer = setTimeout(() => reject(new Error(`${what}: no answer for ${ms / 1000} s`)), ms);
  });
  try {
    return await Promise.race([promise, late]);
  } finally {
    clearTimeout(timer);
  }
}

/** Launches a separate browser; `close` ends it within seconds, whatever it is doing. */
export async function launch() {
  const server = await chromium.launchServer({ executablePath: CHROMIUM, headless: true, args: ARGUMENTS });
  const browser = await chromium.connect(server.wsEndpoint());
  return {
    pid: server.process().pid,
    /** A page with its own profile; see `newPage`. */
    async newPage(options = {}) {
      const opening = browser.newContext({ viewport: { width: 800, height: 500 }, ...options });
      return newPage(await within(HUNG_MS, "the browser", opening), () => server.kill());
    },
    async close() {
      await within(CLOSE_MS, "the browser", server.close()).catch(() => server.kill());
    },
  };
}

/**
 * A page with everything that it complains about. Lines about failed requests are kept apart, because they come from
 * the network. If the page hangs, the browser is killed, so that everything waiting for it fails.
 */
async function newPage(context, kill) {
  const page = await within(HUNG_MS, "a new page", context.newPage());
  const complaints = [];
  const failedRequests = [];
  page.on("pageerror", (error) => complaints.push(String(error)));
  page.on("console", (message) => {
    if (message.type() !== "error" && message.type() !== "warning") return;
    // Software graphics log warnings of their own.
    if (/GPU stall|GL Driver Message|WebGL-0x/.test(message.text())) return;
    (/^Failed to load resource/.test(message.text()) ? failedRequests : complaints).push(
      `${message.type()}: ${message.text()}`,
    );
  });
  let asking = false;
  const watch = setInterval(async () => {
    if (asking) return;
    asking = true;
    const answer = page.evaluate(() => 0).catch(() => {}); // navigated, or closed
    await within(HUNG_MS, "the page", answer).catch((error) => {
      clearInterval(watch);
      complaints.push(String(error));
      return kill();
    });
    asking = false;
  }, ASKED_MS);
  async function end() {
    clearInterval(watch);
    await within(CLOSE_MS, "closing a page", context.close()).catch(kill);
  }
  return Object.assign(page, { complaints, failedRequests, end });
}

/** A browser for the tests of a file; each test gets a new page as `page` of the returned object. */
export function pages({ begin = async () => {}, end = async () => {}, network = true } = {}) {
  const tests = { browser: null, page: null };
  node.before(async () => {
    tests.browser = await launch();
  });
  node.after(async () => {
    await tests.browser?.close();
  });
  node.beforeEach(async () => {
    tests.page = null;
    await begin();
    tests.page = await tests.browser.newPage();
  });
  node.afterEach(async () => {
    const { page } = tests;
    try {
      assert.deepEqual(page?.complaints ?? [], []);
      if (network) assert.deepEqual(page?.failedRequests ?? [], []);
    } finally {
      await page?.end();
      await end();
    }
  });
  return tests;
}

export const state = (page) => page.evaluate(() => window.slicewalk?.state() ?? null);

/** Waits until the state fits; fails with the last state if it never does. */
export async function until(page, what, fits, { timeout = 60_000 } = {}) {
  const end = Date.now() + timeout;
  let last = null;
  for (;;) {
    last = await state(page).catch(() => null);
    if (last !== null && fits(last)) return last;
    if (Date.now() > end || page.isClosed()) throw new Error(`never ${what}: ${JSON.stringify(last)}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

/** Opens the page at an address and waits until the pawn can walk. */
export async function walkIn(page, address) {
  await page.goto(address);
  return until(page, "ready", ({ ready, error }) => {
    if (error !== null) throw new Error(`the page says: ${error}`);
    return ready;
  });
}

/** Holds keys until the state fits. */
export async function hold(page, keys, what, fits, options) {
  for (const key of keys) await page.keyboard.down(key);
  try {
    return await until(page, what, fits, options);
  } finally {
    for (const key of [...keys].reverse()) await page.keyboard.up(key).catch(() => {});
  }
}

/** Colours in the middle of the screen, where nothing covers the canvas: red, green and blue of every seventh pixel. */
export function pixels(page) {
  return page.evaluate(
    () =>
      new Promise((resolve) => {
        const view = document.querySelector("canvas.view");
        // The page draws in its own callback of a frame, before this one, and only what has changed: in the other frames its
        // canvas is empty. A page that is shown again draws once.
        window.dispatchEvent(new Event("pageshow"));
        const frame = () => {
          const canvas = new OffscreenCanvas(view.width, view.height);
          const context = canvas.getContext("2d");
          context.drawImage(view, 0, 0);
          const [w, h] = [canvas.width, canvas.height];
          const { data } = context.getImageData(w / 4, h / 3, w / 4, h / 3);
          if (data[3] === 0) return requestAnimationFrame(frame);
          const seen = [];
          for (let n = 0; n < data.length; n += 4 * 7) seen.push([...data.subarray(n, n + 3)]);
          resolve(seen);
        };
        requestAnimationFrame(frame);
      }),
  );
}

/** Drops a file on the page. */
export async function drop(page, name, bytes) {
  const transfer = await page.evaluateHandle(
    ([name, content]) => {
      const data = new DataTransfer();
      data.items.add(new File([new Uint8Array(content)], name));
      return data;
    },
    [name, [...bytes]],
  );
  await page.dispatchEvent("body", "drop", { dataTransfer: transfer });
}
