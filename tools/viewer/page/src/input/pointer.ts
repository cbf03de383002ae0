// Mouse, pen and fingers on the canvas: dragging looks, clicks choose places, the mouse can be captured.

/** Longest time between the clicks of a double click (ms). */
const DOUBLE_MS = 260;
/** Time after a refusal before the mouse is captured again (ms); browsers refuse for a second after Escape. */
const REFUSED_MS = 1_200;
/** Largest movement of a click (pixels); beyond it the pointer drags. */
const STILL_PX = 5;

export interface PointerEvents {
  /** Dragged, or moved while captured (CSS pixels); `pan` with the right button or shift. */
  drag(right: number, down: number, pan: boolean): void;
  /** Clicked at a place on the screen, x and y from -1 to 1, up is positive; the middle while captured. */
  click(x: number, y: number): void;
  doubleClick(x: number, y: number): void;
  hover(x: number, y: number): void;
  zoom(factor: number): void;
  /** Returns whether a click should capture the mouse instead. */
  captures(): boolean;
  captured(captured: boolean): void;
  /** The browser does not let the mouse be captured, at least not now. */
  refused(): void;
}

export class Pointer {
  readonly #fingers = new Map<number, { x: number; y: number }>();
  #moved = 0;
  #timer = 0;
  #refusedAt = Number.NEGATIVE_INFINITY;

  constructor(
    readonly canvas: HTMLCanvasElement,
    readonly events: PointerEvents,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", (event) => this.#fingers.delete(event.pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    document.addEventListener("pointerlockchange", () => events.captured(this.captured));
    document.addEventListener("pointerlockerror", () => this.#refuse());
  }

  get captured(): boolean {
    return document.pointerLockElement === this.canvas;
  }

  release(): void {
    if (this.captured) document.exitPointerLock();
  }

  #place(event: MouseEvent): [number, number] {
    if (this.captured) return [0, 0];
    const box = this.canvas.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2];
  }

  #down(event: PointerEvent): void {
    this.canvas.focus({ preventScroll: true });
    this.#fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.#moved = 0;
    if (!this.captured) this.canvas.setPointerCapture(event.pointerId);
  }

  #move(event: PointerEvent): void {
    if (this.captured) {
      this.events.drag(event.movementX, event.movementY, false);
      this.events.hover(0, 0);
      return;
    }
    const last = this.#fingers.get(event.pointerId);
    if (last === undefined) {
      this.events.hover(...this.#place(event));
      return;
    }
    const [right, down] = [event.clientX - last.x, event.clientY - last.y];
    const spread = this.#spread();
    this.#fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.#moved += Math.hypot(right, down);
    if (this.#moved < STILL_PX) return;
    if (this.#fingers.size === 2) {
      const now = this.#spread();
      if (spread > 0 && now > 0) this.events.zoom(spread / now);
      this.events.drag(right / 2, down / 2, true);
    } else {
      this.events.drag(right, down, event.shiftKey || (event.buttons & 6) !== 0);
    }
  }

  /** Distance between two fingers. */
  #spread(): number {
    const [a, b] = [...this.#fingers.values()];
    return a && b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
  }

  #up(event: PointerEvent): void {
    const clicked = this.#fingers.delete(event.pointerId) && this.#moved < STILL_PX && event.button === 0;
    if (!clicked || this.#fingers.size > 0) return;
    if (this.events.captures() && !this.captured && event.pointerType === "mouse" && !this.#isRefused) {
      void this.#capture();
      return;
    }
    const place = this.#place(event);
    if (this.#timer !== 0) {
      clearTimeout(this.#timer);
      this.#timer = 0;
      this.events.doubleClick(...place);
      return;
    }
    this.#timer = window.setTimeout(() => {
      this.#timer = 0;
      this.events.click(...place);
    }, DOUBLE_MS);
  }

  #refuse(): void {
    this.#refusedAt = performance.now();
    this.events.refused();
  }

  get #isRefused(): boolean {
    return performance.now() - this.#refusedAt < REFUSED_MS;
  }

  async #capture(): Promise<void> {
    try {
      await this.canvas.requestPointerLock();
    } catch {
      this.#refuse(); // dragging looks, and the next click walks there
    }
  }

  #wheel(event: WheelEvent): void {
    event.preventDefault();
    this.events.zoom(Math.exp(Math.max(-200, Math.min(200, event.deltaY)) / 400));
  }
}
