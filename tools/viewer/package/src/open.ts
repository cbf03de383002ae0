/** Opens archives in a worker. */

import { OpenArchive } from "./archive.js";
import { aborted, asError } from "./fault.js";
import { type Archive, type OpenOptions, SlicewalkError } from "./types.js";

/** Opens the archive at an address, or in a file chosen by the user. */
export async function openArchive(source: string | URL | Blob, options: OpenOptions = {}): Promise<Archive> {
  if (options.signal?.aborted) {
    throw aborted();
  }
  if (!options.worker && typeof Worker === "undefined") {
    const text = 'there are no Web Workers here, as in Node.js: use openArchiveHere from "slicewalk/here"';
    throw new SlicewalkError("engine", text);
  }
  let worker: Worker;
  try {
    worker = options.worker ? options.worker() : new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  } catch (thrown) {
    throw asError(thrown);
  }
  const archive = new OpenArchive(worker);
  await archive.open(source, options);
  return archive;
}
