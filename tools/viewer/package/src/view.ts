/** Views as seen by the page. */

import { callable, number, optional, place } from "./check.js";
import type { Link } from "./link.js";
import type { ColoursEvent, PageEvent, SceneSettings } from "./protocol.js";
import type { PageGeometry, Vec3, View, ViewOptions, ViewSettings } from "./types.js";

function complete(settings: ViewSettings): SceneSettings {
  const { radius = 40, triangles = 1_000_000, detail = 0.01, overview = false, blocks = false } = settings;
  return [number(radius, "radius"), number(triangles, "triangles"), number(detail, "detail"), overview, blocks];
}

/** The corner indices of triangles are the same in every page except for their number. */
let indices = new Uint32Array(0);

function quadIndices(quads: number): Uint32Array {
  if (indices.length < 6 * quads) {
    const room = Math.max(quads, indices.length / 3, 1 << 14);
    indices = new Uint32Array(6 * room);
    for (let quad = 0; quad < room; quad++) {
      indices.set([4 * quad, 4 * quad + 1, 4 * quad + 2, 4 * quad, 4 * quad + 2, 4 * quad + 3], 6 * quad);
    }
  }
  return indices.subarray(0, 6 * quads);
}

function geometry({ page, positions, normals, attributes }: PageEvent, pixelSize: number): PageGeometry {
  const { tx, ty, layer, level } = page;
  return {
    id: page.page,
    key: { tx, ty, layer, level },
    cell: pixelSize * Math.round(page.scaleX / pixelSize),
    origin: [page.x, page.y, page.z],
    scale: [page.scaleX, page.scaleY, page.scaleZ],
    bounds: { min: [page.minX, page.minY, page.minZ], max: [page.maxX, page.maxY, page.maxZ] },
    positions,
    normals,
    attributes,
    indices: quadIndices(positions.length / 12),
  };
}

export class ViewHandle implements View {
  /** Name in the worker, once it has answered. */
  private name: number | undefined;
  private at: Vec3 | undefined;
  private settings: ViewSettings;
  private closed = false;

  constructor(
    private readonly link: Link,
    private readonly options: ViewOptions,
    private readonly pixelSize: number,
    private readonly registry: Map<number, ViewHandle>,
  ) {
    const { onPage, onDrop, onColours } = optional(options);
    callable(onPage, "onPage");
    callable(onDrop, "onDrop");
    if (onColours) {
      callable(onColours, "onColours");
    }
    this.settings = options;
    const sent = complete(options);
    link.call<number>({ call: "view", settings: sent, colours: Boolean(onColours) }).then(
      (name) => this.begin(name, sent),
      // The caller that opened the archive learns that it failed.
      () => undefined,
    );
  }

  private begin(name: number, sent: SceneSettings): void {
    if (this.closed) {
      this.link.note({ note: "forget", name });
      return;
    }
    this.name = name;
    this.registry.set(name, this);
    const settings = complete(this.settings);
    if (settings.some((value, n) => value !== sent[n])) {
      this.link.note({ note: "view", view: name, settings });
    }
    if (this.at) {
      this.look(this.at);
    }
  }

  look(at: Vec3): void {
    const camera = place(at, "the place of a camera");
    this.at = camera;
    if (this.name !== undefined) {
      this.link.note({ note: "look", view: this.name, at: Float64Array.from(camera) });
    }
  }

  set(settings: ViewSettings): void {
    const changed = { ...this.settings, ...optional(settings) };
    const sent = complete(changed);
    this.settings = changed;
    if (this.name !== undefined) {
      this.link.note({ note: "view", view: this.name, settings: sent });
    }
  }

  close(): void {
    this.closed = true;
    if (this.name !== undefined) {
      this.registry.delete(this.name);
      this.link.note({ note: "forget", name: this.name });
      this.name = undefined;
    }
  }

  page(message: PageEvent): void {
    this.options.onPage(geometry(message, this.pixelSize));
  }

  colours({ paint, cells, colours }: ColoursEvent): void {
    this.options.onColours?.({ id: paint.page, edge: paint.edge, cells, colours });
  }

  drop(ids: Uint32Array): void {
    for (const id of ids) {
      this.options.onDrop(id);
    }
  }
}
