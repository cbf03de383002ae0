/** Addresses of archives, engines and modules. */

import { refused, shown } from "./check.js";
import { SlicewalkError } from "./types.js";

/** Resolves an address against that of the page or of the worker. */
export function absolute(address: string | URL): string {
  const text: unknown = typeof address === "string" ? address : (address as Partial<URL> | null | undefined)?.href;
  if (typeof text !== "string") {
    throw refused(`an address is a text or a URL, found ${shown(address)}`);
  }
  try {
    const base = typeof document === "undefined" ? globalThis.location?.href : document.baseURI;
    return new URL(text, base).href;
  } catch (cause) {
    throw new SlicewalkError("invalid", `${text} is no address`, { cause });
  }
}
