// NanoVDB: a mask grid, made of OpenVDB's as its documentation shows.
//
// Places by `isActive` of a read accessor. Boxes leaf by leaf: `probeLeaf` finds a block of 8 x 8 x 8 voxels or says that
// there is none, and eight words of its mask answer for its voxels; `getDim` says how much to skip where there is none.
// Value by value it would take a thousand times as long. Rays by its HDDA over the same accessor. Its own `firstActive`
// goes a whole voxel ahead at every step, and so through thin matter; the loop here goes a thousandth of one.

#include "peer.h"

#include <nanovdb/NanoVDB.h>
#include <nanovdb/util/HDDA.h>
#include <nanovdb/util/OpenToNanoVDB.h>
#include <nanovdb/util/Ray.h>
#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>

#include <cmath>
#include <exception>
#include <limits>
#include <memory>
#include <sstream>

namespace {

using MaskGrid = nanovdb::NanoGrid<nanovdb::ValueMask>;
using Accessor = nanovdb::ReadAccessor<nanovdb::ValueMask, 0, 1, 2>;
using Ray = nanovdb::Ray<double>;

// Forward from a face, so that rounding does not find the voxel before it (voxels).
constexpr double AHEAD = 1e-3;

struct Grid {
  nanovdb::GridHandle<nanovdb::HostBuffer> handle;
  const MaskGrid* grid = nullptr;
  openvdb::MaskGrid::Ptr open;
  double edge = 0.0;
};

// Whether a voxel between two corners, both inclusive, is active.
bool hits(Accessor& accessor, const nanovdb::Coord& low, const nanovdb::Coord& high) {
  nanovdb::Coord at;
  for (int x = low[0]; x <= high[0];) {
    const int next_x = (x | 7) + 1;
    for (int y = low[1]; y <= high[1];) {
      const int next_y = (y | 7) + 1;
      for (int z = low[2]; z <= high[2];) {
        const int next_z = (z | 7) + 1;
        at = nanovdb::Coord(x, y, z);
        if (const auto* leaf = accessor.probeLeaf(at)) {
          const auto& mask = leaf->valueMask();
          // Word x, bit 8 y + z.
          const int z0 = z & 7, z1 = (next_z <= high[2] ? 7 : high[2] & 7);
          const int y0 = y & 7, y1 = (next_y <= high[1] ? 7 : high[1] & 7);
          const int x0 = x & 7, x1 = (next_x <= high[0] ? 7 : high[0] & 7);
          const uint64_t row = (0xffu >> (7 - (z1 - z0))) << z0;
          const uint64_t rows = (0x0101010101010101u >> (8 * (7 - (y1 - y0)))) << (8 * y0);
          for (int k = x0; k <= x1; ++k) {
            if (mask.getWord<uint64_t>(k) & (row * rows)) return true;
          }
          z = next_z;
        } else if (accessor.isActive(at)) {
          return true;
        } else {
          // Only along z: what is empty in x and y too is found empty again in a step.
          const int dim = static_cast<int>(accessor.getDim(at, Ray()));
          z = dim > 8 ? (z | (dim - 1)) + 1 : next_z;
        }
      }
      y = next_y;
    }
    x = next_x;
  }
  return false;
}

double cast(Accessor& accessor, const nanovdb::CoordBBox& bounds, const double* q, double edge) {
  const nanovdb::Vec3d origin(q[0] / edge, q[1] / edge, q[2] / edge), way(q[3], q[4], q[5]);
  Ray ray(origin, way, 0.0, q[6] / edge);
  if (!ray.clip(bounds)) return std::numeric_limits<double>::infinity();
  double at = ray.t0();
  nanovdb::Coord voxel = nanovdb::RoundDown<nanovdb::Coord>(ray(at + AHEAD));
  nanovdb::HDDA<Ray> hdda(ray, accessor.getDim(voxel, ray));
  while (!accessor.isActive(voxel)) {
    if (!hdda.step()) return std::numeric_limits<double>::infinity();
    at = hdda.time();
    voxel = nanovdb::RoundDown<nanovdb::Coord>(ray(at + AHEAD));
    hdda.update(ray, accessor.getDim(voxel, ray));
  }
  return at * edge;
}

}  // namespace

extern "C" {

void* peer_build(const Matter* matter) {
  try {
    openvdb::initialize();
    auto built = std::make_unique<Grid>();
    built->edge = matter->edge;
    built->open = openvdb::MaskGrid::create();
    built->open->setTransform(openvdb::math::Transform::createLinearTransform(matter->edge));
    auto accessor = built->open->getAccessor();
    for (size_t n = 0; n < matter->cube_count; ++n) {
      const int32_t* cube = matter->cubes + 3 * n;
      accessor.setValueOn(openvdb::Coord(cube[0], cube[1], cube[2]));
    }
    built->open->pruneGrid();
    built->handle = nanovdb::openToNanoVDB(openvdb::GridBase::Ptr(built->open));
    built->grid = built->handle.grid<nanovdb::ValueMask>();
    return built->grid ? built.release() : nullptr;
  } catch (const std::exception&) {
    return nullptr;
  }
}

void peer_free(void* peer) { delete static_cast<Grid*>(peer); }

int peer_ask(const void* peer, int kind, const double* questions, size_t count, double* answers) {
  const Grid& grid = *static_cast<const Grid*>(peer);
  const double edge = grid.edge;
  Accessor accessor(grid.grid->tree().root());
  const auto voxel = [edge](const double* q) {
    return nanovdb::Coord(static_cast<int>(std::floor(q[0] / edge)), static_cast<int>(std::floor(q[1] / edge)),
                          static_cast<int>(std::floor(q[2] / edge)));
  };
  switch (kind) {
    case POINTS:
      for (size_t n = 0; n < count; ++n) answers[n] = accessor.isActive(voxel(questions + 3 * n)) ? 1.0 : 0.0;
      return 1;
    case BOXES:
      for (size_t n = 0; n < count; ++n) {
        const double* q = questions + 6 * n;
        answers[n] = hits(accessor, voxel(q), voxel(q + 3)) ? 1.0 : 0.0;
      }
      return 1;
    case RAYS: {
      const nanovdb::CoordBBox bounds = grid.grid->tree().root().bbox();
      for (size_t n = 0; n < count; ++n) answers[n] = cast(accessor, bounds, questions + 7 * n, edge);
      return 1;
    }
    default:
      return 0;
  }
}

const char* peer_version() { return OPENVDB_LIBRARY_VERSION_STRING; }

size_t peer_file_bytes(const void* peer, int which) {
  const Grid& grid = *static_cast<const Grid*>(peer);
  // The plain file is the grid as it lies in memory, behind a short head.
  if (which == 0) return grid.handle.size();
  try {
    std::ostringstream stream;
    openvdb::io::Stream file(stream);
    file.setCompression(openvdb::io::COMPRESS_ZIP | openvdb::io::COMPRESS_ACTIVE_MASK);
    file.write(openvdb::GridCPtrVec{grid.open});
    return stream.str().size();
  } catch (const std::exception&) {
    return 0;
  }
}

size_t peer_memory_bytes(const void* peer) { return static_cast<const Grid*>(peer)->handle.size(); }

}  // extern "C"
