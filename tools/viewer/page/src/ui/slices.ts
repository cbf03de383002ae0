// The slider through the slices of the archive, with the pawn's slice marked, and the cut above the pawn.

import type { ArchiveInfo } from "slicewalk";
import { metres } from "../geometry";
import { texts } from "../languages";
import { h, write } from "./dom";

export interface SliceChoice {
  /** Only this slice is shown; null: all. */
  readonly slice: number | null;
  readonly roof: boolean;
}

export class SlicesPanel {
  readonly element = h("section", { class: "panel slices", "aria-label": texts.tools.slices, hidden: true });
  readonly #one = h("input", { type: "checkbox", id: "slice-one" });
  readonly #roof = h("input", { type: "checkbox", id: "slice-roof", checked: true });
  readonly #slider = h("input", { type: "range", id: "slice", step: 1 });
  readonly #mark = h("div", { class: "mark", "aria-hidden": "true" });
  readonly #value = h("output", { for: "slice" });
  readonly #pawn = h("p", { class: "quiet" });
  #info: ArchiveInfo | null = null;

  constructor(readonly changed: (choice: SliceChoice) => void) {
    const tell = (): void => {
      this.#describe();
      changed(this.choice);
    };
    this.#slider.addEventListener("input", () => {
      this.#one.checked = true;
      tell();
    });
    [this.#one, this.#roof].forEach((box) => box.addEventListener("change", tell));
    this.element.append(
      h("h2", {}, texts.tools.slices),
      h("div", { class: "field check" }, this.#one, h("label", { for: "slice-one" }, texts.slices.one)),
      h("label", { for: "slice", class: "visually-hidden" }, texts.slices.slider),
      h("div", { class: "slider" }, this.#slider, this.#mark),
      this.#value,
      this.#pawn,
      h("div", { class: "field check" }, this.#roof, h("label", { for: "slice-roof" }, texts.slices.roof)),
    );
  }

  get choice(): SliceChoice {
    const slice = this.#one.checked && this.#info?.slices ? this.#slider.valueAsNumber + this.#info.slices.lowest : null;
    return { slice, roof: this.#roof.checked };
  }

  open(info: ArchiveInfo): void {
    this.#info = info;
    const { lowest, highest } = info.slices ?? { lowest: 0, highest: 0 };
    // The slider counts from the lowest slice, as `slicetool show --slice` does.
    Object.assign(this.#slider, { min: "0", max: String(highest - lowest) });
    this.#slider.value = String(Math.floor((highest - lowest) / 2));
    this.#one.checked = false;
    this.#describe();
  }

  /** Marks the pawn's slice. */
  update(z: number): void {
    if (!this.#info?.slices || this.element.hidden) return;
    const { lowest, highest } = this.#info.slices;
    const slice = this.#sliceOf(z) - lowest;
    const count = highest - lowest + 1;
    const share = Math.min(1, Math.max(0, count > 1 ? slice / (count - 1) : 0));
    this.#mark.style.left = `calc(${share} * (100% - 16px) + 8px)`;
    write(this.#pawn, texts.slices.pawn(slice));
    if (!this.#one.checked && document.activeElement !== this.#slider) {
      this.#slider.value = String(slice);
      this.#describe();
    }
  }

  #sliceOf(z: number): number {
    const { origin, sliceHeight } = this.#info ?? { origin: [0, 0, 0], sliceHeight: 1 };
    return Math.floor((z - origin[2] + 1e-6) / sliceHeight);
  }

  #describe(): void {
    const info = this.#info;
    if (!info?.slices) return;
    const n = this.#slider.valueAsNumber;
    const low = info.origin[2] + (n + info.slices.lowest) * info.sliceHeight;
    const text = texts.slices.value(
      n,
      info.slices.highest - info.slices.lowest + 1,
      metres(low),
      metres(low + info.sliceHeight),
    );
    write(this.#value, text);
    this.#slider.setAttribute("aria-valuetext", text);
  }
}
