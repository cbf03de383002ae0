// Names of archives as people read them.

/** The last part of an address or a path; names need not be valid addresses. */
export function shortName(name: string): string {
  const last = name.split(/[?#]/)[0]?.split("/").at(-1) || name;
  try {
    return decodeURIComponent(last);
  } catch {
    return last; // such as 50%.slices
  }
}
