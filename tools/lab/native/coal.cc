// Coal, once HPP-FCL: a box against an octree of OctoMap.
//
// The tree is built as in `octomap.cc`. A box is asked for its first contact only, without the contact's place: the least
// that its documentation asks for a yes or no.

#include "peer.h"

#include <coal/collision.h>
#include <coal/octree.h>
#include <coal/shape/geometric_shapes.h>
#include <octomap/OcTree.h>

#include <exception>
#include <memory>

namespace {

struct World {
  std::shared_ptr<coal::OcTree> tree;
};

}  // namespace

extern "C" {

void* peer_build(const Matter* matter) {
  try {
    auto octree = std::make_shared<octomap::OcTree>(matter->edge);
    for (size_t n = 0; n < matter->cube_count; ++n) {
      const int32_t* cube = matter->cubes + 3 * n;
      octomap::OcTreeKey key;
      const auto middle = [&](int axis) { return (cube[axis] + 0.5) * matter->edge; };
      if (!octree->coordToKeyChecked(middle(0), middle(1), middle(2), key)) return nullptr;
      octree->updateNode(key, true, true);
    }
    octree->updateInnerOccupancy();
    octree->toMaxLikelihood();
    octree->prune();
    auto world = std::make_unique<World>();
    world->tree = std::make_shared<coal::OcTree>(octree);
    world->tree->computeLocalAABB();
    return world.release();
  } catch (const std::exception&) {
    return nullptr;
  }
}

void peer_free(void* peer) { delete static_cast<World*>(peer); }

int peer_ask(const void* peer, int kind, const double* questions, size_t count, double* answers) {
  if (kind != BOXES) return 0;
  const World& world = *static_cast<const World*>(peer);
  const coal::CollisionRequest request(coal::NO_REQUEST, 1);
  const coal::Transform3s here = coal::Transform3s::Identity();
  coal::CollisionResult result;
  for (size_t n = 0; n < count; ++n) {
    const double* q = questions + 6 * n;
    const coal::Box box(q[3] - q[0], q[4] - q[1], q[5] - q[2]);
    const coal::Vec3s middle((q[0] + q[3]) / 2, (q[1] + q[4]) / 2, (q[2] + q[5]) / 2);
    result.clear();
    answers[n] = coal::collide(&box, coal::Transform3s(middle), world.tree.get(), here, request, result) ? 1.0 : 0.0;
  }
  return 1;
}

const char* peer_version() { return COAL_VERSION; }

size_t peer_file_bytes(const void*, int) { return 0; }

size_t peer_memory_bytes(const void* peer) {
  return static_cast<const World*>(peer)->tree->getTree()->memoryUsage();
}

}  // extern "C"
