// Which nodes of an octree of points are worth drawing from a place: those whose points lie far apart as seen from there, and
// whose own points or those of their ancestors are not close enough together.

/** Depth, x, y and z of a node, as COPC names it. */
export type NodeName = string;

/** The octree of a COPC file: its cube (minimum and maximum of x, y and z) and the spacing of its root's points. */
export interface Octree {
  readonly cube: readonly number[];
  readonly spacing: number;
  /** Number of points of a node; null if it does not exist. May have to read for it. */
  points(name: NodeName): Promise<number | null>;
}

export interface Choice {
  /** Coarse nodes first, each after its parent. */
  readonly names: readonly NodeName[];
  /** Spacing of the chosen points over their distance, at most: what is missing lies closer together. */
  readonly gap: number;
}

/** Nothing is nearer than this (in units of the file): detail ends with the nodes around the eye anyway. */
const NEAREST = 0.5;

const CHILDREN = Array.from({ length: 8 }, (_, n) => [n & 1, (n >> 1) & 1, n >> 2]);

/** Distance from a place to the box of a node. */
function distanceTo(name: readonly number[], { cube }: Octree, eye: readonly number[]): number {
  const [depth = 0, ...at] = name;
  let sum = 0;
  for (let axis = 0; axis < 3; axis++) {
    const edge = ((cube[axis + 3] ?? 0) - (cube[axis] ?? 0)) / 2 ** depth;
    const low = (cube[axis] ?? 0) + (at[axis] ?? 0) * edge;
    const from = eye[axis] ?? 0;
    sum += Math.max(low - from, 0, from - low - edge) ** 2;
  }
  return Math.sqrt(sum);
}

/**
 * Chooses nodes of at most `most` points for an eye, none farther than `far`, the widest gaps first, down to gaps of `finest` (over
 * distance).
 */
export async function choose(tree: Octree, eye: readonly number[], most: number, far: number, finest: number): Promise<Choice> {
  const names: NodeName[] = [];
  /** The gap that a node's parent leaves there. */
  const gapWithout = (name: readonly number[]): number => {
    const away = distanceTo(name, tree, eye);
    return away > far ? 0 : (2 * tree.spacing) / 2 ** (name[0] ?? 0) / Math.max(away, NEAREST);
  };
  const front = [{ name: [0, 0, 0, 0], gap: Infinity }];
  let total = 0;
  for (;;) {
    const widest = front.reduce((best, { gap }, n) => (gap > (front[best]?.gap ?? 0) ? n : best), 0);
    const [next] = front.splice(widest, 1);
    if (next === undefined || next.gap <= 0) return { names, gap: 0 };
    if (next.gap < finest) return { names, gap: next.gap };
    const name = next.name.join("-");
    const count = await tree.points(name);
    if (count === null) continue;
    if (total + count > most) return { names, gap: next.gap === Infinity ? 0 : next.gap };
    total += count;
    if (count > 0) names.push(name);
    const [depth = 0, x = 0, y = 0, z = 0] = next.name;
    for (const [i = 0, j = 0, k = 0] of CHILDREN) {
      const child = [depth + 1, 2 * x + i, 2 * y + j, 2 * z + k];
      front.push({ name: child, gap: gapWithout(child) });
    }
  }
}
