// An open archive with its pawn and the geometry around it.

import { openArchive, SlicewalkError, type Archive, type Bounds, type Vec3, type View } from "slicewalk";
import { standing, type Look } from "./geometry";
import { Pawn } from "./pawn";
import { contentBounds } from "./scene/framing";
import { World } from "./scene/world";
import { walkerSettings, type Settings } from "./settings";
import { findStart, viewFrom } from "./start";
import { shortName } from "./ui/names";
import { crsName } from "./ui/status";

/** Distance around a pawn that must be loaded before a place counts as loaded (m). */
const AROUND_M = 0.3;
/** Longest wait for a step after a jump to another place (ms). */
const PATIENCE_MS = 10_000;
/** Height above the middle of a scan without a place to stand (m). */
const HOVER_M = 2;
/** Budget that stays below 64 MiB with an overview level, which takes a quarter more. */
const BUDGET_BYTES = 51 << 20;

export interface Source {
  /** Argument of `openArchive`. */
  readonly archive: string | Blob;
  /** Part of a link; null for a local file. */
  readonly link: string | null;
  /** As people read it. */
  readonly name: string;
}

/** The archive at an address relative to the page. */
export function fromAddress(url: string): Source {
  try {
    return { archive: new URL(url, location.href).href, link: url, name: shortName(url) };
  } catch (cause) {
    throw new SlicewalkError("invalid", `${url} is no address`, { cause });
  }
}

const NOTHING: Bounds = { min: [0, 0, 0], max: [0, 0, 0] };

export class Session {
  readonly world: World;
  readonly view: View;
  /** Boxes of all pages, and their bounds without strays. */
  boxes = new Float64Array();
  content: Bounds = NOTHING;
  crs = "";
  /** Metres per unit of the input; 1 if it is unknown, or if inputs have several. */
  unit = 1;

  private constructor(
    readonly source: Source,
    readonly archive: Archive,
    readonly pawn: Pawn,
  ) {
    this.world = new World(archive.info.pixelSize, archive.info.sliceHeight);
    const coloured = archive.info.voxels.coloured > 0;
    this.view = archive.view({
      overview: true,
      onPage: (page) => this.world.take(page),
      onDrop: (id) => this.world.drop(id),
      ...(coloured && { onColours: (colours) => this.world.colour(colours) }),
    });
  }

  static async open(
    source: Source,
    at: Vec3 | null,
    look: Look | null,
    settings: Settings,
    signal: AbortSignal,
  ): Promise<Session> {
    const archive = await openArchive(source.archive, { signal, budgetBytes: BUDGET_BYTES });
    try {
      const boxes = await archive.pageBoxes();
      const content = contentBounds(boxes, archive.info.bounds) ?? NOTHING;
      const found = at ?? (await findStart(archive, settings, content, signal));
      const middle = (axis: 0 | 1): number => (content.min[axis] + content.max[axis]) / 2;
      const place: Vec3 = found ?? [middle(0), middle(1), content.max[2] + HOVER_M];
      await archive.load(around(place, settings), { signal });
      const pawn = new Pawn(await archive.walker({ ...walkerSettings(settings), at: place }));
      pawn.flying = found === null;
      if (look === null && at !== null) Object.assign(pawn.look, (await viewFrom(archive, place, settings.eye, signal)).look);
      else if (look !== null) Object.assign(pawn.look, look);
      const session = new Session(source, archive, pawn);
      Object.assign(session, { boxes, content });
      return session;
    } catch (error) {
      archive.close();
      throw error;
    }
  }

  /** Reads what the first step does not need. */
  async describe(): Promise<void> {
    try {
      const { crs, unit } = await this.archive.reference();
      this.crs = crsName(crs);
      this.unit = unit.factor ?? 1;
    } catch {
      // A failed archive is reported elsewhere.
    }
  }

  /** Moves the pawn elsewhere; resolves when the place is loaded. */
  async goto(at: Vec3, settings: Settings): Promise<void> {
    await this.pawn.place(at);
    await this.archive.load(around(at, settings));
    await this.#stands();
  }

  /**
   * Resolves when a step no longer waits for pages, or when no step is answered because the page may be in the
   * background.
   */
  async #stands(): Promise<void> {
    const { steps } = this.pawn.state;
    const end = performance.now() + PATIENCE_MS;
    while ((this.pawn.state.steps === steps || this.pawn.state.missing > 0) && performance.now() < end) {
      await new Promise((resolve) => setTimeout(resolve, 10));
    }
  }

  close(): void {
    this.archive.close();
    this.world.clear();
  }
}

function around(at: Vec3, { width, height }: Settings): ReturnType<typeof standing> {
  return standing([at[0], at[1], at[2] - AROUND_M], width + 2 * AROUND_M, height + 2 * AROUND_M);
}
