// The measuring tool: values at the cursor, and the distance of two clicked places.

import type { Archive, Vec3 } from "slicewalk";
import { BufferGeometry, Group, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, SphereGeometry } from "three";
import { metres, type Ray } from "../geometry";
import { between, pick, surroundings, type Value } from "../measure";
import type { World } from "../scene/world";
import { texts } from "../texts.en";
import { h, write } from "./dom";

const ROWS = ["place", "headroom", "width", "step", "distance", "across", "height"] as const;
const POINT_M = 0.04;

type Row = (typeof ROWS)[number];

export class MeasurePanel {
  readonly element = h("section", { class: "panel measure", "aria-label": texts.tools.measure, hidden: true });
  readonly marks = new Group();
  readonly #values = new Map<Row, HTMLElement>();
  #points: Vec3[] = [];
  #asking: AbortController | null = null;
  #next: Ray | null = null;

  constructor() {
    const list = h("dl");
    for (const row of ROWS) {
      const value = h("dd", { "data-measure": row }, "–");
      this.#values.set(row, value);
      list.append(h("div", {}, h("dt", {}, texts.measure[row]), value));
    }
    const clear = (): void => this.clear();
    this.element.append(
      h("h2", {}, texts.tools.measure),
      h("p", { class: "quiet" }, texts.measure.hint),
      list,
      h("button", { type: "button", class: "plain", onclick: clear }, texts.measure.clear),
    );
  }

  clear(): void {
    this.#points = [];
    this.#asking?.abort();
    this.#values.forEach((value) => write(value, "–"));
    this.#mark(null);
  }

  /** Measures at the cursor; while an answer is pending, the newest ray waits. */
  hover(archive: Archive, ray: Ray): void {
    this.#next = ray;
    if (this.#asking === null) void this.#measure(archive);
  }

  async click(archive: Archive, world: World, ray: Ray): Promise<void> {
    const spot = await pick(archive, ray, new AbortController().signal).catch(() => null);
    if (spot === null) return;
    this.#points = this.#points.length === 1 ? [...this.#points, spot.at] : [spot.at];
    const [a, b] = this.#points;
    const length = a && b ? between(archive, a, b) : null;
    this.#write("distance", length?.straight ?? null, "–");
    this.#write("across", length?.across ?? null, "–");
    this.#write("height", length?.height ?? null, "–");
    this.#mark(world);
  }

  /** Moves the marks after the local origin has changed. */
  moved(world: World): void {
    if (this.#points.length > 0) this.#mark(world);
  }

  async #measure(archive: Archive): Promise<void> {
    const asking = new AbortController();
    this.#asking = asking;
    try {
      while (this.#next !== null && !asking.signal.aborted) {
        const ray = this.#next;
        this.#next = null;
        const spot = await pick(archive, ray, asking.signal);
        if (spot === null) continue;
        const around = await surroundings(archive, spot.at, asking.signal);
        if (asking.signal.aborted) break;
        write(this.#values.get("place") as HTMLElement, spot.at.map((value) => metres(value)).join("  "));
        this.#write("headroom", around.headroom, texts.measure.open);
        this.#write("width", around.width, texts.measure.open);
        this.#write("step", around.step, texts.measure.none);
      }
    } catch {
      // Cancelled, or a failed archive, which is reported elsewhere.
    } finally {
      this.#asking = null;
    }
  }

  #write(row: Row, value: Value | null, otherwise: string): void {
    const element = this.#values.get(row) as HTMLElement;
    const text =
      value === null
        ? otherwise
        : `${metres(value.metres)} m ${texts.measure.error(metres(value.error, value.error < 0.01 ? 3 : 2))}`;
    write(element, text);
    if (value === null) delete element.dataset["metres"];
    else element.dataset["metres"] = String(value.metres);
  }

  #mark(world: World | null): void {
    this.marks.clear();
    if (world === null) return;
    const places = this.#points.map((point) => world.local(point));
    const material = new MeshBasicMaterial({ color: "#ffb547", depthTest: false });
    for (const place of places) {
      const ball = new Mesh(new SphereGeometry(POINT_M, 12, 8), material);
      ball.position.copy(place);
      ball.renderOrder = 2;
      this.marks.add(ball);
    }
    if (places.length === 2) {
      const line = new Line(
        new BufferGeometry().setFromPoints(places),
        new LineBasicMaterial({ color: "#ffb547", depthTest: false }),
      );
      line.renderOrder = 2;
      this.marks.add(line);
    }
  }
}
