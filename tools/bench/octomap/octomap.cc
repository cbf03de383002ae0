// Asks OctoMap what the others are asked: builds an octree of points, answers boxes, and says what it costs.
//
//   octomap CUBE_M POINTS BOXES REPEATS SAMPLES ANSWERS TREE
//
// POINTS: x y z of each point; BOXES: min x y z, max x y z of each box; both as f64 in the order of this machine. Into
// ANSWERS, as f64: for each box 1 (hit) or 0; then for each repeat the time of each box (ns); then up to SAMPLES occupied
// cubes as x y z of their least corner. TREE is where the binary tree (.bt) goes. Standard output has lines "name value".
//
// As its documentation advises: occupied points with lazy evaluation, inner nodes afterwards in one go, then the maximum
// likelihood map, which prunes best. Nothing is known to be free, so the tree has only what is occupied.

#include <octomap/OcTree.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

namespace {

using octomap::OcTree;
using octomap::OcTreeKey;
using octomap::OcTreeNode;
using Clock = std::chrono::steady_clock;

constexpr int ROUNDS = 3;
// A tree of 16 levels has so many cubes to a side.
constexpr double SIDE = 65536.0;

[[noreturn]] void fail(const std::string& what) {
  std::fprintf(stderr, "octomap: %s\n", what.c_str());
  std::exit(1);
}

double nanoseconds(Clock::time_point since) {
  return std::chrono::duration<double, std::nano>(Clock::now() - since).count();
}

std::vector<double> read(const char* path, size_t group) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  const std::streamoff bytes = file ? static_cast<std::streamoff>(file.tellg()) : -1;
  if (bytes < 0) fail(std::string(path) + ": cannot be read");
  if (bytes % static_cast<std::streamoff>(group * sizeof(double)) != 0) fail(std::string(path) + ": is cut off");
  std::vector<double> values(static_cast<size_t>(bytes) / sizeof(double));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(values.data()), bytes);
  if (!file) fail(std::string(path) + ": cannot be read");
  return values;
}

// Lowest and highest key that a box touches, held inside the tree.
struct Keys {
  int low[3], high[3];

  Keys(const double* box, double cube) {
    for (int axis = 0; axis < 3; ++axis) {
      // The same arithmetic as that of coordToKey: a point in the box has a key in the range.
      const auto key = [cube](double value) {
        return static_cast<int>(std::clamp(std::floor(1.0 / cube * value) + SIDE / 2, -1.0, SIDE));
      };
      low[axis] = key(box[axis]);
      high[axis] = key(box[axis + 3]);
    }
  }
};

// Whether an occupied leaf under a node lies in the range: down from the root, only into what meets the box, and not
// into what lies in it whole. Faster than the leaf iterator of a bounding box, which visits every leaf.
bool hits(const OcTree& tree, const OcTreeNode* node, const int (&corner)[3], int edge, const Keys& keys) {
  bool whole = true;
  for (int axis = 0; axis < 3; ++axis) {
    const int end = corner[axis] + edge - 1;
    if (end < keys.low[axis] || corner[axis] > keys.high[axis]) return false;
    whole = whole && keys.low[axis] <= corner[axis] && end <= keys.high[axis];
  }
  // The value of an inner node is the greatest of its children: none is occupied where it is not.
  if (!tree.isNodeOccupied(node)) return false;
  if (whole || !tree.nodeHasChildren(node)) return true;
  const int half = edge / 2;
  for (unsigned child = 0; child < 8; ++child) {
    if (!tree.nodeChildExists(node, child)) continue;
    const int inner[3] = {corner[0] + ((child & 1) ? half : 0), corner[1] + ((child & 2) ? half : 0),
                          corner[2] + ((child & 4) ? half : 0)};
    if (hits(tree, tree.getNodeChild(node, child), inner, half, keys)) return true;
  }
  return false;
}

bool hits(const OcTree& tree, const double* box) {
  const int origin[3] = {0, 0, 0};
  const OcTreeNode* root = tree.getRoot();
  return root && hits(tree, root, origin, static_cast<int>(SIDE), Keys(box, tree.getResolution()));
}

double build(OcTree& tree, const std::vector<double>& points) {
  const auto start = Clock::now();
  for (size_t at = 0; at < points.size(); at += 3) {
    OcTreeKey key;
    if (!tree.coordToKeyChecked(points[at], points[at + 1], points[at + 2], key)) fail("a point lies outside the tree");
    tree.updateNode(key, true, true);
  }
  tree.updateInnerOccupancy();
  tree.toMaxLikelihood();
  tree.prune();
  return nanoseconds(start) / 1e9;
}

// Appends the answers, and the times of each repeat: for each box the best of some rounds, less the clock's own.
void ask(const OcTree& tree, const std::vector<double>& boxes, size_t repeats, std::vector<double>& out) {
  std::vector<double> idle(10000);
  for (double& time : idle) time = nanoseconds(Clock::now());
  std::sort(idle.begin(), idle.end());
  const double clock = idle[idle.size() / 2];
  const size_t count = boxes.size() / 6;
  for (size_t n = 0; n < count; ++n) out.push_back(hits(tree, &boxes[6 * n]) ? 1.0 : 0.0);
  size_t differ = 0;
  for (size_t repeat = 0; repeat < repeats; ++repeat) {
    std::vector<double> best(count, 1e300);
    for (int round = 0; round < ROUNDS; ++round) {
      for (size_t n = 0; n < count; ++n) {
        const auto start = Clock::now();
        const bool hit = hits(tree, &boxes[6 * n]);
        best[n] = std::min(best[n], nanoseconds(start));
        // Used, so that the compiler keeps the call.
        differ += hit != (out[n] == 1.0);
      }
    }
    for (const double time : best) out.push_back(std::max(0.0, time - clock));
  }
  if (differ) fail("the same box has two answers");
}

// Appends about every n-th of all occupied cubes of the finest level; gives how many there are.
size_t sample(const OcTree& tree, size_t most, std::vector<double>& out) {
  size_t cubes = 0;
  for (int pass = 0; pass < 2; ++pass) {
    const size_t every = most ? (cubes + most - 1) / most : 0;
    size_t seen = 0;
    for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
      if (!tree.isNodeOccupied(*leaf)) continue;
      const int edge = 1 << (tree.getTreeDepth() - leaf.getDepth());
      const OcTreeKey key = leaf.getIndexKey();
      for (int n = 0; n < edge * edge * edge; ++n, ++seen) {
        if (pass == 0 || !every || seen % every) continue;
        const int at[3] = {n % edge, n / edge % edge, n / edge / edge};
        for (int axis = 0; axis < 3; ++axis) {
          out.push_back((key[axis] + at[axis] - SIDE / 2) * tree.getResolution());
        }
      }
    }
    cubes = seen;
  }
  return cubes;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 8) fail("expected CUBE_M POINTS BOXES REPEATS SAMPLES ANSWERS TREE");
  const double cube = std::strtod(argv[1], nullptr);
  if (!(cube > 0.0) || !std::isfinite(cube)) fail("the cube is no length above 0");
  const std::vector<double> points = read(argv[2], 3);
  const std::vector<double> boxes = read(argv[3], 6);
  OcTree tree(cube);
  const double seconds = build(tree, points);
  std::vector<double> out;
  ask(tree, boxes, std::strtoull(argv[4], nullptr, 10), out);
  const size_t cubes = sample(tree, std::strtoull(argv[5], nullptr, 10), out);
  std::ofstream answers(argv[6], std::ios::binary);
  answers.write(reinterpret_cast<const char*>(out.data()), static_cast<std::streamsize>(out.size() * sizeof(double)));
  answers.close();
  if (!answers) fail(std::string(argv[6]) + ": cannot be written");
  std::printf("build_s %.9f\nresident_bytes %zu\noccupied_cubes %zu\n", seconds, tree.memoryUsage(), cubes);
  // Last: it prunes once more, which changes nothing now.
  if (!tree.writeBinary(std::string(argv[7]))) fail(std::string(argv[7]) + ": cannot be written");
  return 0;
}
