// OctoMap behind six plain functions, so that the benchmarks can ask it in their own process, as they ask the others.
//
// As its documentation advises: occupied points with lazy evaluation, inner nodes afterwards in one go, then the maximum
// likelihood map, which prunes best. Nothing is known to be free, so the tree has only what is occupied.

#include <octomap/OcTree.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <exception>
#include <sstream>

namespace {

using octomap::OcTree;
using octomap::OcTreeKey;
using octomap::OcTreeNode;

// A tree of 16 levels has so many cubes to a side.
constexpr double SIDE = 65536.0;

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

}  // namespace

extern "C" {

// A tree of `count` points, x y z each (m); null where a point lies outside of it or memory runs out.
void* octree_build(const double* points, size_t count, double cube) {
  OcTree* tree = nullptr;
  try {
    tree = new OcTree(cube);
    for (size_t at = 0; at < 3 * count; at += 3) {
      OcTreeKey key;
      if (!tree->coordToKeyChecked(points[at], points[at + 1], points[at + 2], key)) {
        delete tree;
        return nullptr;
      }
      tree->updateNode(key, true, true);
    }
    tree->updateInnerOccupancy();
    tree->toMaxLikelihood();
    tree->prune();
    return tree;
  } catch (const std::exception&) {
    delete tree;
    return nullptr;
  }
}

void octree_free(void* tree) { delete static_cast<OcTree*>(tree); }

// 1 where a box (least and greatest x y z) touches an occupied leaf, else 0.
int octree_hits(const void* handle, const double* box) {
  const OcTree& tree = *static_cast<const OcTree*>(handle);
  const int origin[3] = {0, 0, 0};
  const OcTreeNode* root = tree.getRoot();
  return root && hits(tree, root, origin, static_cast<int>(SIDE), Keys(box, tree.getResolution())) ? 1 : 0;
}

// Its own count of memory (bytes).
size_t octree_memory_bytes(const void* tree) { return static_cast<const OcTree*>(tree)->memoryUsage(); }

// How many occupied leaves there are; x y z of the least corner and the edge (m) of so many as there is room for.
size_t octree_leaves(const void* handle, double* leaves, size_t room) {
  const OcTree& tree = *static_cast<const OcTree*>(handle);
  size_t count = 0;
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    if (!tree.isNodeOccupied(*leaf)) continue;
    if (count < room) {
      const OcTreeKey key = leaf.getIndexKey();
      for (int axis = 0; axis < 3; ++axis) leaves[4 * count + axis] = (key[axis] - SIDE / 2) * tree.getResolution();
      leaves[4 * count + 3] = leaf.getSize();
    }
    ++count;
  }
  return count;
}

// Bytes of the binary tree (.bt) without the few lines of text before it; 0 where memory runs out.
size_t octree_binary_bytes(const void* tree) {
  try {
    std::ostringstream stream;
    static_cast<const OcTree*>(tree)->writeBinaryData(stream);
    return stream.str().size();
  } catch (const std::exception&) {
    return 0;
  }
}

}  // extern "C"
