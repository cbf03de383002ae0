// Sharing: a link to the place, or a picture.

import { formatAddress, type Place } from "./address";
import type { Stage } from "./modes/mode";
import { texts } from "./texts.en";

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
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(picture);
  anchor.download = name;
  anchor.click();
  URL.revokeObjectURL(anchor.href);
  shell.messages.say(texts.news.screenshot(name));
}
