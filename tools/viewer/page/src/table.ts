// The table of files beside the page, written by `slicetool serve` and `slicetool site`.

export interface Table {
  readonly archives: readonly { readonly name: string; readonly url: string }[];
  /** A point cloud to draw over the archive. */
  readonly cloud: string | null;
}

export async function readTable(): Promise<Table> {
  const none = { archives: [], cloud: null };
  try {
    const answer = await fetch("archives.json");
    return answer.ok ? { ...none, ...((await answer.json()) as Partial<Table>) } : none;
  } catch {
    return none;
  }
}
