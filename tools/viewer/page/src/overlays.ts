// Point cloud and Gaussian splats over an open archive, only for display: collisions use the archive.

import type { Vec3 } from "slicewalk";
import type { Canvas } from "./canvas";
import { thousands } from "./geometry";
import { ALIGNED, type Alignment } from "./scene/alignment";
import { Cloud } from "./scene/cloud";
import { Splats } from "./scene/splats";
import type { Session } from "./session";
import { texts } from "./languages";
import type { Shell } from "./ui/shell";

/** A file of splats: its address, or the file itself. */
export type SplatsSource = string | File;

/** Most points of a cloud, and those that graphics by the processor draw in time. */
const MOST_POINTS = 2_000_000;
const SOFTWARE_POINTS = 400_000;

export class Overlays {
  #session: Session | null = null;
  #cloudUrl: string | null = null;
  #cloud: Cloud | null = null;
  #source: SplatsSource | null = null;
  #alignment = ALIGNED;
  #splats: Splats | null = null;
  /** Number of the latest request for splats; results of earlier ones are dropped. */
  #reading = 0;
  #changes = 0;

  constructor(
    readonly canvas: Canvas,
    readonly shell: Shell,
  ) {}

  /** Numbers of points and splats drawn. */
  get counts(): { points: number; splats: number } {
    return { points: this.#cloud?.count ?? 0, splats: this.#splats?.count ?? 0 };
  }

  /** Whether something is drawn whose colours the finish would change. */
  get bringColours(): boolean {
    return this.#splats !== null;
  }

  /** Another text after each change of what is drawn. */
  get revision(): string {
    return `${this.#changes} ${this.#cloud?.revision ?? ""}`;
  }

  /** Part of a link; null without splats, or for a local file. */
  get link(): { readonly url: string; readonly alignment: Alignment } | null {
    return typeof this.#source === "string" ? { url: this.#source, alignment: this.#alignment } : null;
  }

  /** Offers a point cloud beside the page. */
  offer(cloudUrl: string | null): void {
    this.#cloudUrl = cloudUrl;
  }

  opened(session: Session): void {
    this.#session = session;
    if (this.#source !== null) void this.showSplats(true);
    this.#tell();
  }

  left(): void {
    this.showCloud(false);
    void this.showSplats(false);
    this.#session = null;
  }

  /** Follows the scene's local origin. */
  place(): void {
    this.#changes += 1;
    if (this.#session !== null) this.#splats?.place(this.#alignment, this.#session.world);
  }

  /** Draws the cloud as it is seen; see `Cloud.follow`. */
  follow(eye: Vec3, reach: number | null, focal: number): void {
    if (this.#session !== null) this.#cloud?.follow(this.#session.world, eye, reach, focal);
  }

  showCloud(shown: boolean): void {
    const session = this.#session;
    this.#changes += 1;
    if (this.#cloud !== null) {
      this.canvas.scene.remove(this.#cloud.group);
      this.#cloud.close();
      this.#cloud = null;
    }
    if (shown && session !== null && this.#cloudUrl !== null) {
      const url = new URL(this.#cloudUrl, location.href).href;
      const most = this.canvas.isSoftware ? SOFTWARE_POINTS : MOST_POINTS;
      const { cloud: counted, noCloud } = texts.news;
      const cloud: Cloud = new Cloud(url, session.pawn.at, session.unit, session.world, most, (told) => {
        if (this.#cloud !== cloud) return;
        this.shell.messages.say(typeof told === "number" ? counted(thousands(told)) : noCloud(told));
        // Its switch tries again.
        if (typeof told === "string") this.showCloud(false);
      });
      this.#cloud = cloud;
      this.canvas.scene.add(cloud.group);
    }
    this.#tell();
  }

  /** Loads other splats, shown at once if an archive is open. */
  take(source: SplatsSource, alignment: Alignment): void {
    this.#source = source;
    this.align(alignment);
    this.shell.overlays.alignment = alignment;
    if (this.#session !== null) void this.showSplats(true);
  }

  async showSplats(shown: boolean): Promise<void> {
    const reading = ++this.#reading;
    this.#changes += 1;
    if (this.#splats !== null) {
      this.canvas.scene.remove(this.#splats.group);
      this.#splats.close();
      this.#splats = null;
    }
    const source = this.#source;
    if (shown && source !== null) {
      const { messages } = this.shell;
      try {
        const from = typeof source === "string" ? new URL(source, location.href).href : source;
        const splats = await Splats.load(from, this.canvas.renderer);
        if (reading !== this.#reading) {
          splats.close();
          return;
        }
        this.#splats = splats;
        this.place();
        this.canvas.scene.add(splats.group);
        messages.say(texts.news.splats(thousands(splats.count)));
      } catch (error) {
        if (reading !== this.#reading) return;
        messages.say(texts.news.noSplats(error instanceof Error ? error.message : String(error)));
      }
    }
    this.#tell();
  }

  align(alignment: Alignment): void {
    this.#alignment = alignment;
    this.place();
  }

  /** Shows or hides the archive itself. */
  showMatter(shown: boolean): void {
    if (this.#session !== null) this.#session.world.matter = shown;
  }

  #tell(): void {
    const cloud = this.#cloudUrl === null ? null : this.#cloud !== null;
    const splats = this.#source === null ? null : this.#splats !== null;
    if (!cloud && !splats) this.showMatter(true);
    this.shell.overlays.show(cloud, splats, this.#session?.world.matter ?? true);
  }
}
