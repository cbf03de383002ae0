// Keys by their position on the keyboard, so that W A S D are adjacent on every layout.

import { nothing, type Intent } from "./intent";

const HELD = new Set([
  "KeyW",
  "KeyA",
  "KeyS",
  "KeyD",
  "KeyQ",
  "KeyE",
  "KeyC",
  "Space",
  "ShiftLeft",
  "ShiftRight",
  "ArrowUp",
  "ArrowDown",
  "ArrowLeft",
  "ArrowRight",
  "PageUp",
  "PageDown",
]);

/**
 * Returns whether a key belongs to the focused element: a text field, a slider, a list, or a button that it presses. Escape
 * belongs to dialogs only.
 */
function isTaken(event: KeyboardEvent): boolean {
  if (event.ctrlKey || event.altKey || event.metaKey) return true;
  const { target } = event;
  if (!(target instanceof HTMLElement)) return false;
  if (target.closest("dialog[open]") !== null) return true;
  if (event.code === "Escape") return false;
  if (target instanceof HTMLInputElement && target.type === "checkbox") return event.code === "Space";
  if (target.matches("input, select, textarea")) return true;
  return target.matches("button, a, summary") && (event.code === "Space" || event.code === "Enter");
}

export class Keyboard {
  readonly #down = new Set<string>();
  #jump = false;
  /** Crouches until C is pressed, or the pawn is told to jump. */
  #crouch = false;

  /** `pressed` is called once for each key that does not walk. */
  constructor(pressed: (code: string) => void) {
    window.addEventListener("keydown", (event) => {
      if (isTaken(event)) return;
      if (HELD.has(event.code)) {
        event.preventDefault();
        if (event.code === "Space" && !event.repeat) this.#jump = true;
        if (event.code === "Space" || event.code === "KeyC") this.#crouch = false;
        this.#down.add(event.code);
      } else if (!event.repeat) {
        pressed(event.code);
      }
    });
    window.addEventListener("keyup", (event) => this.#down.delete(event.code));
    // The browser does not report keys released elsewhere.
    const release = (): void => this.release();
    window.addEventListener("blur", release);
    document.addEventListener("visibilitychange", release);
  }

  release(): void {
    this.#down.clear();
    this.#jump = false;
  }

  latchCrouch(): void {
    this.#crouch = true;
  }

  read(): Intent {
    const held = (...codes: string[]): number => (codes.some((code) => this.#down.has(code)) ? 1 : 0);
    const intent: Intent = {
      ...nothing(),
      forward: held("KeyW", "ArrowUp") - held("KeyS", "ArrowDown"),
      right: held("KeyD") - held("KeyA"),
      turn: held("ArrowRight", "KeyE") - held("ArrowLeft", "KeyQ"),
      tilt: held("PageUp") - held("PageDown"),
      lift: held("Space") - held("KeyC"),
      run: held("ShiftLeft", "ShiftRight") > 0,
      // A key pressed and released between two frames still jumps.
      jump: this.#jump || held("Space") > 0,
      crouch: this.#crouch || held("KeyC") > 0,
    };
    this.#jump = false;
    return intent;
  }
}
