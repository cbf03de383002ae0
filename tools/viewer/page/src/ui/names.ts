// Names of archives as people read them.

/** The last part of an address; it need not be a valid one. Names of files are read as they are. */
export function shortName(url: string): string {
  const last = url.split(/[?#]/)[0]?.split("/").at(-1) || url;
  try {
    return decodeURIComponent(last);
  } catch {
    return last; // such as 50%.slices
  }
}
