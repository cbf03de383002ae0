// Shown while no archive is open: drop one, choose one, or enter its address. Files may be dropped at any time.

import { isSplats } from "../scene/alignment";
import { texts } from "../languages";
import { h, icons, picture } from "./dom";

export interface WelcomeEvents {
  files(files: readonly File[]): void;
  /** Splats to draw over the open archive. */
  splatsFile(file: File): void;
  address(url: string): void;
  /** Returns to the open archive, if there is one. */
  close(): void;
}

export class Welcome {
  readonly element: HTMLDialogElement;
  readonly #offered = h("div", { class: "offered", role: "group", "aria-label": texts.open.archives, hidden: true });
  readonly #close = h(
    "button",
    { type: "button", class: "tool close", "aria-label": texts.tools.close, hidden: true, onclick: () => this.hide() },
    picture(icons.close),
  );
  /** Whether there is a scan to return to, and whether something was chosen. */
  #returns = false;
  #taken = false;
  readonly curtain = h("div", { class: "curtain", hidden: true, "aria-hidden": "true" }, h("p", {}, texts.open.drop));

  constructor(readonly events: WelcomeEvents) {
    const input = h("input", { type: "file", id: "open-file", multiple: true, class: "visually-hidden" });
    input.addEventListener("change", () => {
      const files = [...(input.files ?? [])];
      input.value = "";
      if (files.length > 0) this.#take(() => events.files(files));
    });
    const address = h("input", {
      type: "text",
      inputmode: "url",
      id: "open-address",
      placeholder: "https://…/scan.slices",
      autocomplete: "url",
      required: true,
    });
    const form = h("form", {
      class: "address",
      onsubmit: (event) => {
        event.preventDefault();
        this.#take(() => events.address(address.value.trim()));
      },
    });
    form.append(
      h("label", { for: "open-address" }, texts.open.address),
      h("div", { class: "row" }, address, h("button", { class: "primary" }, texts.open.go)),
    );
    this.element = h(
      "dialog",
      { class: "welcome", "aria-labelledby": "welcome-title" },
      h("h1", { id: "welcome-title" }, texts.open.heading),
      this.#close,
      h("p", {}, texts.open.lead),
      this.#offered,
      h(
        "div",
        { class: "drop" },
        h("label", { for: "open-file", class: "primary" }, texts.open.choose),
        input,
        h("p", { class: "quiet" }, texts.open.hint),
      ),
      form,
      h("p", { class: "quiet" }, texts.open.convert),
    );
    this.element.addEventListener("cancel", (event) => {
      if (!this.#returns) event.preventDefault();
    });
    this.element.addEventListener("close", () => {
      // At a second Escape, browsers close a dialog whatever its page says; nothing to act on would remain.
      if (this.#taken || this.#returns) events.close();
      else this.show();
    });
    this.#listen();
  }

  /** Offers the archives beside the page. */
  offer(archives: readonly { readonly name: string; readonly url: string }[]): void {
    const choose = (url: string) => (): void => this.#take(() => this.events.address(url));
    const buttons = archives.map(({ name, url }) =>
      h("button", { type: "button", class: "plain", onclick: choose(url) }, name),
    );
    this.#offered.replaceChildren(...buttons);
    this.#offered.hidden = archives.length === 0;
  }

  /** An archive is open: closes, and may be closed without a choice from now on. */
  opened(): void {
    this.#returns = true;
    this.#close.hidden = false;
    this.hide();
  }

  show(): void {
    this.#taken = false;
    if (!this.element.open) this.element.showModal();
  }

  hide(): void {
    if (this.element.open) this.element.close();
  }

  #take(act: () => void): void {
    this.#taken = true;
    this.hide();
    act();
  }

  async #drop(files: readonly File[]): Promise<void> {
    const [file] = files;
    if (file === undefined) return;
    // A file that cannot be read is refused where all others are.
    const splats = files.length === 1 && (await isSplats(file).catch(() => false));
    this.#take(() => (splats ? this.events.splatsFile(file) : this.events.files(files)));
  }

  #listen(): void {
    const carriesFile = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") === true;
    window.addEventListener("dragover", (event) => {
      if (!carriesFile(event)) return;
      event.preventDefault();
      this.curtain.hidden = false;
    });
    window.addEventListener("dragleave", (event) => {
      if (event.relatedTarget === null) this.curtain.hidden = true;
    });
    window.addEventListener("drop", (event) => {
      if (!carriesFile(event)) return;
      event.preventDefault();
      this.curtain.hidden = true;
      void this.#drop([...(event.dataTransfer?.files ?? [])]);
    });
  }
}
