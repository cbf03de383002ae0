// One-line news that disappear, and problems that stay until a person decides.

import { texts } from "../languages";
import { h, write } from "./dom";

const NEWS_MS = 4500;

export interface Action {
  readonly label: string;
  readonly act: () => void;
}

export class Messages {
  readonly news = h("div", { class: "news", role: "status", "aria-live": "polite", hidden: true });
  readonly progress = h(
    "div",
    { class: "progress", hidden: true },
    h("progress", { "aria-label": texts.loading.place }),
    h("span"),
  );
  readonly dialog = h("dialog", { class: "trouble", "aria-labelledby": "trouble-title" });
  /** Called when a problem is closed without a decision, as by Escape. */
  dismissed: () => void = () => {};
  #decided = false;
  #timer = 0;

  constructor() {
    this.dialog.addEventListener("close", () => {
      // The event may come when another problem is shown.
      if (!this.dialog.open && !this.#decided) this.dismissed();
    });
  }

  /** Shows news for as long as reading takes. */
  say(text: string, ms = NEWS_MS): void {
    clearTimeout(this.#timer);
    this.news.hidden = false;
    write(this.news, text);
    this.#timer = window.setTimeout(() => this.unsay(text), ms);
  }

  /** Ends these news, if they are still shown. */
  unsay(text: string): void {
    if (this.news.textContent !== text) return;
    this.news.hidden = true;
    write(this.news, "");
  }

  /** Shows what the page waits for; null: nothing. */
  wait(text: string | null): void {
    this.progress.hidden = text === null;
    const [bar, words] = this.progress.children;
    if (text !== null && bar && words instanceof HTMLElement) {
      write(words, text);
      bar.setAttribute("aria-label", text);
    }
  }

  trouble(kind: keyof typeof texts.errors, detail: string, actions: readonly Action[]): void {
    const { title, wayOut } = texts.errors[kind];
    const buttons = actions.map(({ label, act }, n) =>
      h(
        "button",
        {
          type: "button",
          class: n === 0 ? "primary" : "plain",
          onclick: () => {
            this.clear();
            act();
          },
        },
        label,
      ),
    );
    this.dialog.replaceChildren(
      h("h2", { id: "trouble-title" }, title),
      h("p", { class: "detail" }, detail),
      h("p", {}, wayOut),
      h("div", { class: "actions" }, ...buttons),
    );
    this.#decided = false;
    if (!this.dialog.open) this.dialog.showModal();
  }

  clear(): void {
    this.#decided = true;
    if (this.dialog.open) this.dialog.close();
  }
}
