// A drawing of a storey as a sheet in SVG, true to scale: cut walls black on white, with a grid, a scale bar and north.

import { metres } from "../geometry";
import { texts } from "../languages";
import { BELOW, CUT, UNKNOWN, type Drawing } from "./drawing";

/** Room on a sheet of A3 in landscape, and the margin around (mm). */
const [ROOM_X, ROOM_Y, MARGIN] = [390, 250, 15];
/** Height of the lines of text below (mm). */
const FOOT = 16;
const SCALES = [10, 20, 25, 50, 100, 200, 250, 500, 1000, 2000, 2500, 5000, 10_000, 25_000, 50_000, 100_000];
const STEPS_M = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000];
/** Least distance of the grid's lines (mm). */
const GRID = 18;

type Corner = readonly [x: number, y: number];

/** Outlines of all cells of a kind, in cells from the lower left corner; inside by the even-odd rule. */
export function outlines({ width, height, cells }: Drawing, kind: number): Corner[][] {
  const is = (x: number, y: number): boolean =>
    x >= 0 && y >= 0 && x < width && y < height && cells[(height - 1 - y) * width + x] === kind;
  // Edges with the cell on their left, by their first corner: to the right, up, to the left, down.
  const ways: readonly Corner[] = [
    [1, 0],
    [0, 1],
    [-1, 0],
    [0, -1],
  ];
  const starts = new Uint8Array((width + 1) * (height + 1));
  const at = (x: number, y: number): number => y * (width + 1) + x;
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      if (!is(x, y)) continue;
      const edges = [
        [is(x, y - 1), x, y, 0],
        [is(x + 1, y), x + 1, y, 1],
        [is(x, y + 1), x + 1, y + 1, 2],
        [is(x - 1, y), x, y + 1, 3],
      ] as const;
      for (const [inner, i, j, way] of edges) {
        if (!inner) starts[at(i, j)] = (starts[at(i, j)] ?? 0) | (1 << way);
      }
    }
  }
  const found: Corner[][] = [];
  for (let first = 0; first < starts.length; first++) {
    while (starts[first] !== 0) {
      const outline: Corner[] = [];
      let [here, before] = [first, -1];
      do {
        const open = starts[here] ?? 0;
        // Where two cells touch at a corner only, turn left: each keeps an outline of its own.
        const turns = before < 0 ? [0, 1, 2, 3] : [1, 0, 3].map((turn) => (before + turn) % 4);
        const way = turns.find((turn) => (open & (1 << turn)) !== 0);
        if (way === undefined) break;
        starts[here] = open & ~(1 << way);
        const [x, y] = [here % (width + 1), Math.floor(here / (width + 1))];
        if (way !== before) outline.push([x, y]);
        const [dx, dy] = ways[way] ?? [0, 0];
        [here, before] = [at(x + dx, y + dy), way];
      } while (here !== first);
      found.push(outline);
    }
  }
  return found;
}

export interface Title {
  readonly name: string;
  readonly crs: string;
}

/** Draws a sheet; its lengths are millimetres on paper. */
export function svg(drawing: Drawing, { name, crs }: Title): string {
  const { min, cell, width, height, z } = drawing;
  const [wide, high] = [width * cell, height * cell];
  const fits = (scale: number): boolean => (1000 * wide) / scale <= ROOM_X && (1000 * high) / scale <= ROOM_Y;
  const scale = SCALES.find(fits) ?? (SCALES.at(-1) as number);
  const mm = 1000 / scale;
  const [right, bottom] = [MARGIN + wide * mm, MARGIN + high * mm];
  const x = (value: number): string => round(MARGIN + (value - min[0]) * mm);
  const y = (value: number): string => round(bottom - (value - min[1]) * mm);
  const step = STEPS_M.find((metres) => metres * mm >= GRID) ?? (STEPS_M.at(-1) as number);
  const path = (kind: number): string =>
    outlines(drawing, kind)
      .map((corners) => `M${corners.map(([i, j]) => `${x(min[0] + i * cell)} ${y(min[1] + j * cell)}`).join("L")}Z`)
      .join("");
  const lines = (from: number, to: number): number[] => {
    const first = Math.ceil(from / step);
    return Array.from({ length: Math.max(0, Math.floor(to / step) - first + 1) }, (_, n) => (first + n) * step);
  };
  const label = (value: number): string => metres(value, step < 1 ? 1 : 0);
  const [columns, rows] = [lines(min[0], min[0] + wide), lines(min[1], min[1] + high)];
  const { plan } = texts;
  const foot = bottom + 9;
  const unknown = path(UNKNOWN);
  const facts = [plan.cutAt(metres(z)), plan.scale(scale), crs, unknown === "" ? "" : plan.unknown];
  const sheet = [round(right + MARGIN), round(bottom + FOOT + MARGIN / 2)];
  return [
    `<svg xmlns="http://www.w3.org/2000/svg" width="${sheet[0]}mm" height="${sheet[1]}mm" viewBox="0 0 ${sheet.join(" ")}">`,
    `<title>${escaped(name)}</title>`,
    `<rect width="100%" height="100%" fill="#fff"/>`,
    `<path class="below" fill="#d4d4d4" fill-rule="evenodd" d="${path(BELOW)}"/>`,
    `<pattern id="hatch" width="2" height="2" patternUnits="userSpaceOnUse">`,
    `<path stroke="#9aa3ad" stroke-width=".2" d="M0 2L2 0"/>`,
    `</pattern>`,
    `<path class="unknown" fill="url(#hatch)" fill-rule="evenodd" d="${unknown}"/>`,
    `<g stroke="#9aa3ad" stroke-width=".1">`,
    ...columns.map((at) => `<path d="M${x(at)} ${round(MARGIN)}V${round(bottom)}"/>`),
    ...rows.map((at) => `<path d="M${round(MARGIN)} ${y(at)}H${round(right)}"/>`),
    `</g>`,
    `<path class="cut" fill-rule="evenodd" d="${path(CUT)}"/>`,
    `<g font-family="sans-serif" font-size="2.2" fill="#555" text-anchor="middle">`,
    ...columns.map((at) => `<text x="${x(at)}" y="${round(bottom + 3)}">${label(at)}</text>`),
    ...rows.map((at) => `<text transform="translate(${round(MARGIN - 1)} ${y(at)})rotate(-90)">${label(at)}</text>`),
    `</g>`,
    `<g font-family="sans-serif" font-size="3.2">`,
    `<text x="${MARGIN}" y="${round(foot)}">${escaped(name)}</text>`,
    `<text x="${MARGIN}" y="${round(foot + 4.5)}" fill="#555">`,
    escaped(facts.filter((fact) => fact !== "").join(" · ")),
    `</text>`,
    `<path d="M${round(right - step * mm)} ${round(foot - 1)}H${round(right)}v-1.200H${round(right - step * mm)}z"/>`,
    `<text x="${round(right)}" y="${round(foot + 3.5)}" text-anchor="end">${step} m</text>`,
    `<path d="M${round(right - 2)} ${round(MARGIN - 3)}l2 -8l2 8l-2 -1.500z"/>`,
    `<text x="${round(right + 4)}" y="${round(MARGIN - 4)}">${texts.minimap.north.replace(/[^A-Z]/g, "")}</text>`,
    `</g>`,
    `</svg>`,
    "",
  ].join("\n");
}

const round = (value: number): string => String(Math.round(value * 100) / 100);

const escaped = (text: string): string =>
  text.replace(/[&<>"]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[sign] ?? sign);
