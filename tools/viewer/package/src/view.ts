/** Views as seen by the page. */

import type { Link } from "./link.js";
import type { ColoursMessage, PageMessage, SceneSettings } from "./protocol.js";
import type { PageGeometry, Vec3, View, ViewOptions, ViewSettings } from "./types.js";

function complete({ radius = 40, triangles = 1_000_000, detail = 0.01, overview = false }: ViewSettings): SceneSettings {
  return [radius, triangles, detail, overview];
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

function geometry(page: PageMessage, pixelSize: number): PageGeometry {
  const [id = 0, tx = 0, ty = 0, layer = 0, ...rest] = page.numbers;
  const triple = (at: number): Vec3 => [rest[at] ?? 0, rest[at + 1] ?? 0, rest[at + 2] ?? 0];
  const scale = triple(3);
  return {
    id,
    key: { tx, ty, layer, level: rest[12] ?? 0 },
    cell: pixelSize * Math.round(scale[0] / pixelSize),
    origin: triple(0),
    scale,
    bounds: { min: triple(6), max: triple(9) },
    positions: page.positions,
    normals: page.normals,
    attributes: page.attributes,
    indices: quadIndices(page.positions.length / 12),
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
    this.settings = options;
    const sent = complete(options);
    link.call<number>({ call: "view", settings: sent, colours: options.onColours !== undefined }).then(
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
    this.at = at;
    if (this.name !== undefined) {
      this.link.note({ note: "look", view: this.name, at: Float64Array.from(at) });
    }
  }

  set(settings: ViewSettings): void {
    this.settings = { ...this.settings, ...settings };
    if (this.name !== undefined) {
      this.link.note({ note: "view", view: this.name, settings: complete(this.settings) });
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

  page(message: PageMessage): void {
    this.options.onPage(geometry(message, this.pixelSize));
  }

  colours({ numbers, cells, colours }: ColoursMessage): void {
    this.options.onColours?.({ id: numbers[1] ?? 0, edge: numbers[2] ?? 0, cells, colours });
  }

  drop(ids: Uint32Array): void {
    for (const id of ids) {
      this.options.onDrop(id);
    }
  }
}
