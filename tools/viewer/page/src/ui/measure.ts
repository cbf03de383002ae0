// The measuring tool: values at the cursor, the distance of two clicked places, and a list of all that were measured.

import type { Archive, Vec3 } from "slicewalk";
import { BufferGeometry, Group, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, type Object3D, SphereGeometry } from "three";
import { metres, type Ray } from "../geometry";
import { between, pick, surroundings, type Measured, type Value } from "../measure";
import type { World } from "../scene/world";
import { saveAs } from "../share";
import { texts } from "../languages";
import { h, icons, picture, write } from "./dom";

const ROWS = ["place", "headroom", "width", "step", "distance", "across", "height"] as const;
const BALL = new SphereGeometry(0.04, 12, 8);
const INK = { color: "#ffb547", depthTest: false, transparent: true } as const;
const DOT = new MeshBasicMaterial(INK);
const STROKE = new LineBasicMaterial(INK);

type Row = (typeof ROWS)[number];

export class MeasurePanel {
  readonly element = h("section", { class: "panel measure", "aria-label": texts.tools.measure, hidden: true });
  readonly marks = new Group();
  /** Another number after each change of the marks. */
  revision = 0;
  readonly #values = new Map<Row, HTMLElement>();
  readonly #list = h("ol", { class: "measures" });
  readonly #save: HTMLButtonElement;
  #measured: Measured[] = [];
  /** The first place of the next distance. */
  #first: Vec3 | null = null;
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
    const save = (): void => saveAs(new Blob([csv(this.#measured)], { type: "text/csv" }), "measures.csv");
    this.#save = h("button", { type: "button", class: "plain", hidden: true, onclick: save }, texts.measure.save);
    this.element.append(
      h("h2", {}, texts.tools.measure),
      h("p", { class: "quiet" }, texts.measure.hint),
      list,
      this.#list,
      h(
        "div",
        { class: "buttons" },
        this.#save,
        h("button", { type: "button", class: "plain", onclick: clear }, texts.measure.clear),
      ),
    );
  }

  clear(): void {
    this.#first = null;
    this.#measured = [];
    this.#asking?.abort();
    this.#values.forEach((value) => write(value, "–"));
    this.#tell();
    this.#unmark(this.marks.children);
  }

  /** Measures at the cursor; while an answer is pending, the newest ray waits. */
  hover(archive: Archive, ray: Ray): void {
    this.#next = ray;
    if (this.#asking === null) void this.#measure(archive);
  }

  async click(archive: Archive, world: World, ray: Ray): Promise<void> {
    const spot = await pick(archive, ray, new AbortController().signal).catch(() => null);
    if (spot === null) return;
    const from = this.#first;
    this.#first = from === null ? spot.at : null;
    const measured = from === null ? null : between(archive, from, spot.at);
    if (measured !== null) this.#measured.push(measured);
    this.#write("distance", measured?.straight ?? null, "–");
    this.#write("across", measured?.across ?? null, "–");
    this.#write("height", measured?.height ?? null, "–");
    this.#tell();
    this.#mark(world);
  }

  /** Moves the marks after the local origin has changed. */
  moved(world: World): void {
    this.#mark(world);
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

  /** Lists what was measured; a click removes it. */
  #tell(): void {
    this.#save.hidden = this.#measured.length === 0;
    const entries = this.#measured.map((measured, n) => {
      const text = `${metres(measured.straight.metres)} m`;
      const remove = (): void => {
        this.#measured.splice(n, 1);
        this.#unmark(this.marks.children.filter((mark) => mark.userData["measured"] === measured));
        this.#tell();
      };
      const button = h(
        "button",
        { type: "button", class: "tool", "aria-label": texts.measure.remove(n + 1), onclick: remove },
        picture(icons.close),
      );
      return h("li", {}, h("span", {}, text), button);
    });
    this.#list.replaceChildren(...entries);
  }

  /** Removes marks; each line has a geometry of its own. */
  #unmark(marks: readonly Object3D[]): void {
    for (const mark of marks) if (mark instanceof Line) mark.geometry.dispose();
    this.marks.remove(...marks);
    this.revision += 1;
  }

  #mark(world: World): void {
    this.#unmark(this.marks.children);
    const add = (mark: Mesh | Line, measured: Measured | null): void => {
      mark.renderOrder = 2;
      mark.userData["measured"] = measured;
      this.marks.add(mark);
    };
    const point = (place: Vec3, measured: Measured | null): void => {
      const ball = new Mesh(BALL, DOT);
      ball.position.copy(world.local(place));
      add(ball, measured);
    };
    for (const measured of this.#measured) {
      measured.ends.forEach((end) => point(end, measured));
      const ends = measured.ends.map((end) => world.local(end));
      add(new Line(new BufferGeometry().setFromPoints(ends), STROKE), measured);
    }
    if (this.#first !== null) point(this.#first, null);
  }
}

/** A row for each distance; lengths in metres, with their errors. */
function csv(all: readonly Measured[]): string {
  const head = "x0,y0,z0,x1,y1,z1,distance,distance_error,across,across_error,height,height_error";
  const rows = all.map(({ ends, straight, across, height }) => {
    const values = [straight, across, height].flatMap(({ metres, error }) => [metres, error]);
    return [...ends.flat(), ...values].map((value) => value.toFixed(4)).join(",");
  });
  return [head, ...rows, ""].join("\r\n");
}
