// The table of files beside the page, written by `slicetool serve` and `slicetool site`.

export interface Table {
  readonly archives: readonly {
    readonly name: string;
    readonly url: string;
    /** State of the conversion that makes this archive, if it is not there yet. */
    readonly converting?: string;
  }[];
  /** A point cloud to draw over the archive. */
  readonly cloud: string | null;
  /** Seconds after which an idle page returns to its start. */
  readonly kiosk?: number;
  /** A route to walk until somebody touches the page. */
  readonly tour?: string;
  /** Texts and rules of the place. */
  readonly settings?: string;
}

export async function readTable(): Promise<Table> {
  const none = { archives: [], cloud: null };
  try {
    const answer = await fetch("archives.json");
    const table: Partial<Table> = answer.ok ? await answer.json() : {};
    return { ...none, ...table, archives: Array.isArray(table.archives) ? table.archives : [] };
  } catch {
    return none;
  }
}
