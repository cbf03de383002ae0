// What every peer behind plain functions offers, so that the benchmarks ask it in their own process, as they ask the others.
// Places are in metres, counted from an origin near the scene: single precision is enough for the peers that have no other.

#ifndef SLICEWALK_BENCH_PEER_H
#define SLICEWALK_BENCH_PEER_H

#include <cstddef>
#include <cstdint>

extern "C" {

// The voxels, and the triangles of the boundary between occupied and free ones.
struct Matter {
  // Occupied cubes, x y z each: cube n begins at n times the edge.
  const int32_t* cubes;
  size_t cube_count;
  double edge;
  // x y z each.
  const float* vertices;
  size_t vertex_count;
  // Three vertices each.
  const uint32_t* triangles;
  size_t triangle_count;
};

// What is asked, and the numbers of one question.
enum Kind : int {
  // Whether a place is occupied: x y z. Answers 1 or 0.
  POINTS = 0,
  // Whether a box touches matter: least x y z, greatest x y z. Answers 1 or 0.
  BOXES = 1,
  // Distance to the first matter: origin x y z, direction x y z of length 1, greatest distance. Answers the distance, or
  // infinity.
  RAYS = 2,
  // How far a box gets: least x y z, greatest x y z, way x y z. Answers the distance until the first contact, or the whole way.
  SWEEPS = 3,
};

// Builds a peer; null where memory runs out or it refuses.
void* peer_build(const Matter* matter);
void peer_free(void* peer);
// Answers `count` questions; 0 where the peer has no such question.
int peer_ask(const void* peer, int kind, const double* questions, size_t count, double* answers);
// Version of the library, as it says itself.
const char* peer_version();
// Bytes of the peer's own file; 0 where it has none. `which`: 0 for the plain one, 1 for a compressed one.
size_t peer_file_bytes(const void* peer, int which);
// Bytes in memory, by the peer's own count; 0 where it has none.
size_t peer_memory_bytes(const void* peer);

}  // extern "C"

#endif
