// Sharing: a link to the place, a picture, a plan; and the whole screen.

import { formatAddress, type Place } from "./address";
import type { Stage } from "./modes/mode";
import { draw } from "./plan/drawing";
import { svg } from "./plan/svg";
import { texts } from "./languages";

/** Most cells along an edge of a plan that is saved. */
const SHEET_CELLS = 4096;

/** Puts the place into the address and the clipboard; null: all of the scan. */
export async function copyLink({ session, shell }: Stage, place: Omit<Place, "archive"> | null): Promise<void> {
  if (session === null) return;
  const { link } = session.source;
  if (link === null) {
    shell.messages.say(texts.news.local);
    return;
  }
  const nowhere = { at: null, look: null, mode: null, splats: null };
  history.replaceState(null, "", formatAddress({ archive: link, ...(place ?? nowhere) }));
  try {
    await navigator.clipboard.writeText(location.href);
    shell.messages.say(texts.news.linkCopied);
  } catch {
    shell.messages.say(texts.news.link);
  }
}

export async function savePicture({ canvas, shell }: Stage): Promise<void> {
  const picture = await canvas.picture();
  if (picture === null) return;
  const name = `slicewalk-${new Date().toISOString().slice(0, 19).replaceAll(":", "-")}.png`;
  saveAs(picture, name);
  shell.messages.say(texts.news.saved(name));
}

/** Draws all of the storey around the pawn as a sheet. */
export async function savePlan({ session, shell }: Stage): Promise<void> {
  if (session === null) return;
  const { archive, content, pawn, crs, source } = session;
  const [min, max] = [content.min, content.max];
  shell.messages.say(texts.plan.saving);
  try {
    const wanted = { area: [min[0], min[1], max[0], max[1]], floor: pawn.at[2], cells: SHEET_CELLS, load: true } as const;
    const drawing = await draw(archive, wanted, new AbortController().signal);
    const name = `${source.name.replace(/\.slices$/, "")}-${texts.plan.name}.svg`;
    saveAs(new Blob([svg(drawing, { name: source.name, crs })], { type: "image/svg+xml" }), name);
    shell.messages.say(texts.news.saved(name));
  } catch (error) {
    shell.messages.say(error instanceof Error ? error.message : String(error));
  }
}

/** Time after which a browser has certainly begun to save (ms). */
const SAVED_MS = 60_000;

/** Offers content as a file to save. */
export function saveAs(content: Blob, name: string): void {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(content);
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), SAVED_MS);
}

/** Fills the screen with the page, or gives it back. */
export async function toggleFullscreen(): Promise<void> {
  try {
    if (document.fullscreenElement === null) await document.documentElement.requestFullscreen();
    else await document.exitFullscreen();
  } catch {
    // The browser refused.
  }
}
