/** Opens archives in a worker. */

import { OpenArchive } from "./archive.js";
import { optional } from "./check.js";
import { aborted, asError } from "./fault.js";
import { type Archive, type OpenOptions, SlicewalkError } from "./types.js";

/** Opens the archive at an address, or in a file chosen by the user. */
export async function openArchive(source: string | URL | Blob, options?: OpenOptions): Promise<Archive> {
  const given = optional(options);
  if (given.signal?.aborted) {
    throw aborted();
  }
  if (!given.worker && typeof Worker === "undefined") {
    const text = 'there are no Web Workers here, as in Node.js: use openArchiveHere from "slicewalk/here"';
    throw new SlicewalkError("engine", text);
  }
  let archive: OpenArchive;
  try {
    archive = new OpenArchive(
      given.worker ? given.worker() : new Worker(new URL("./worker.js", import.meta.url), { type: "module" }),
    );
  } catch (thrown) {
    throw asError(thrown);
  }
  await archive.open(source, given);
  return archive;
}
