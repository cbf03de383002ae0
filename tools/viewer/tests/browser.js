// Chromium without a window, and pages that fail a test when the page itself throws or complains.

import { existsSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
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

/** A browser with a profile of its own. `close` ends it and removes the profile. */
export async function launch(options = {}) {
  const profile = mkdtempSync(join(tmpdir(), "slicewalk-browser-"));
  const context = await chromium.launchPersistentContext(profile, {
    executablePath: CHROMIUM,
    headless: true,
    args: ARGUMENTS,
    viewport: { width: 800, height: 500 },
    ...options,
  });
  return {
    context,
    async close() {
      await context.close();
      rmSync(profile, { recursive: true, force: true });
    },
  };
}

/** A page, with everything that it complains about. Lines about failed requests are kept apart: they are the network's. */
export async function newPage(context, { scripts = [] } = {}) {
  const page = await context.newPage();
  const complaints = [];
  const failedRequests = [];
  page.on("pageerror", (error) => complaints.push(String(error)));
  page.on("console", (message) => {
    if (message.type() !== "error" && message.type() !== "warning") return;
    // Software graphics warn about themselves.
    if (/GPU stall|GL Driver Message|WebGL-0x/.test(message.text())) return;
    (/^Failed to load resource/.test(message.text()) ? failedRequests : complaints).push(
      `${message.type()}: ${message.text()}`,
    );
  });
  for (const script of scripts) await page.addInitScript(script);
  return Object.assign(page, { complaints, failedRequests });
}

export const state = (page) => page.evaluate(() => window.slicewalk?.state() ?? null);

/** The state once it fits; what it was last, if it never does. */
export async function until(page, what, fits, { timeout = 60_000 } = {}) {
  const end = Date.now() + timeout;
  let last = null;
  for (;;) {
    last = await state(page).catch(() => null);
    if (last !== null && fits(last)) return last;
    if (Date.now() > end) throw new Error(`never ${what}: ${JSON.stringify(last)}`);
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
    for (const key of [...keys].reverse()) await page.keyboard.up(key);
  }
}
