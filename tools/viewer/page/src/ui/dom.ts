// Builds elements in one expression.

type Attributes = Record<string, string | number | boolean | ((event: Event) => void)>;

/**
 * Makes an element; functions become listeners (`onclick`), `true` an attribute without value, `false` no attribute.
 */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value !== false) element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children);
  return element;
}

/**
 * A toolbar button with an icon and a word; the word is hidden where there is no room, but stays for screen readers.
 */
export function tool(icon: string, label: string, key: string | null, onclick: () => void, small = false): HTMLButtonElement {
  const title = key === null ? label : `${label} (${key})`;
  const button = h(
    "button",
    { type: "button", class: small ? "tool small" : "tool", title, onclick },
    h("span", { class: "word" }, label),
  );
  button.prepend(picture(icon));
  return button;
}

/** An icon of strokes on a square of 24. */
export function picture(path: string): SVGSVGElement {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  const stroke = document.createElementNS("http://www.w3.org/2000/svg", "path");
  stroke.setAttribute("d", path);
  svg.append(stroke);
  return svg;
}

/** Writes text only if it differs, which avoids layout and repeated reading by screen readers. */
export function write(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export const icons = {
  walk: "M13 4.500a1.500 1.500 0 1 0 0-.01M8 21l3-6 2 2v4M9 12l2-5 3 1 2 3h2M11 15l-1-4",
  orbit: "M12 9v6M9 12h6M3 12c0-3 4-5 9-5s9 2 9 5-4 5-9 5-9-2-9-5zM12 3c-3 0-5 4-5 9s2 9 5 9 5-4 5-9-2-9-5-9z",
  plan: "M4 4h16v16H4zM4 11h7V4M14 20v-6h6",
  fly: "M12 20V6M6 11l6-6 6 6M5 20h14",
  measure: "M3 16 16 3l5 5L8 21zM7 12l2 2M10 9l2 2M13 6l2 2",
  slices: "M4 17l8 4 8-4M4 12l8 4 8-4M12 3 4 7l8 4 8-4z",
  section: "M4 8v12h12V8zM4 8l4-4h12v12l-4 4M16 8l4-4M10 2v20",
  settings: "M4 7h10M18 7h2M4 17h2M10 17h10M14 7a2 2 0 1 0 4 0 2 2 0 1 0-4 0M6 17a2 2 0 1 0 4 0 2 2 0 1 0-4 0",
  link: "M10 14a4 4 0 0 0 6 0l3-3a4 4 0 0 0-6-6l-1 1M14 10a4 4 0 0 0-6 0l-3 3a4 4 0 0 0 6 6l1-1",
  screenshot: "M4 8h4l2-3h4l2 3h4v11H4zM12 16.500a3 3 0 1 0 0-6 3 3 0 0 0 0 6z",
  fullscreen: "M4 9V4h5M15 4h5v5M20 15v5h-5M9 20H4v-5",
  headset: "M3 8h18v9h-6l-2-3h-2l-2 3H3zM8 12v.01M16 12v.01",
  help: "M9 9a3 3 0 1 1 4 3c-1 .5-1 1-1 2M12 17.500v.01M3 12a9 9 0 1 0 18 0 9 9 0 1 0-18 0",
  colours:
    "M12 3a9 9 0 1 0 0 18c1.500 0 2-1 1.500-2-.7-1.500.3-3 2-3H18a3 3 0 0 0 3-3c0-5-4-10-9-10zM7.500 12v.01M9 7.500v.01M14.500 7.500v.01",
  open: "M4 19V5h6l2 3h8v11zM12 16v-5M9.500 13.500 12 11l2.500 2.500",
  home: "M4 11l8-7 8 7v9h-5v-6H9v6H4z",
  save: "M12 4v10M8 10.500l4 4 4-4M5 15v4h14v-4",
  close: "M6 6l12 12M18 6 6 18",
} as const;
