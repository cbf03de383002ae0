// Embree: rays against the triangles of the boundary.
//
// As its documentation advises for static scenes: one triangle mesh, shared buffers, high build quality, and the robust
// flag, without which rays may slip through the edge that two triangles share. One ray at a time, as a program asks that
// needs the answer before its next question.

#include "peer.h"

#include <sys/types.h>

#include <atomic>
#include <cstdio>
#include <limits>
#include <memory>
#include <new>
#include <string>
#include <vector>

// The part of Embree 4's interface that is used here, by the API reference of its manual: the package `embreex` has the
// library without its headers.
extern "C" {

using RTCDevice = struct RTCDeviceTy*;
using RTCScene = struct RTCSceneTy*;
using RTCGeometry = struct RTCGeometryTy*;

constexpr int RTC_ERROR_NONE = 0;
constexpr int RTC_DEVICE_PROPERTY_VERSION = 0;
constexpr int RTC_BUILD_QUALITY_HIGH = 2;
constexpr int RTC_SCENE_FLAG_ROBUST = 1 << 2;
constexpr int RTC_GEOMETRY_TYPE_TRIANGLE = 0;
constexpr int RTC_BUFFER_TYPE_INDEX = 0;
constexpr int RTC_BUFFER_TYPE_VERTEX = 1;
constexpr int RTC_FORMAT_UINT3 = 0x5003;
constexpr int RTC_FORMAT_FLOAT3 = 0x9003;
constexpr unsigned RTC_INVALID_GEOMETRY_ID = ~0u;

struct alignas(16) RTCRay {
  float org_x, org_y, org_z, tnear, dir_x, dir_y, dir_z, time, tfar;
  unsigned mask, id, flags;
};
// With room for instances, of which builds have one level or more.
struct alignas(16) RTCHit {
  float Ng_x, Ng_y, Ng_z, u, v;
  unsigned primID, geomID, instID[9];
};
struct RTCRayHit {
  RTCRay ray;
  RTCHit hit;
};

RTCDevice rtcNewDevice(const char*);
void rtcReleaseDevice(RTCDevice);
int rtcGetDeviceError(RTCDevice);
ssize_t rtcGetDeviceProperty(RTCDevice, int);
void rtcSetDeviceMemoryMonitorFunction(RTCDevice, bool (*)(void*, ssize_t, bool), void*);
RTCScene rtcNewScene(RTCDevice);
void rtcReleaseScene(RTCScene);
void rtcSetSceneBuildQuality(RTCScene, int);
void rtcSetSceneFlags(RTCScene, int);
unsigned rtcAttachGeometry(RTCScene, RTCGeometry);
void rtcCommitScene(RTCScene);
RTCGeometry rtcNewGeometry(RTCDevice, int);
void rtcReleaseGeometry(RTCGeometry);
void rtcSetGeometryBuildQuality(RTCGeometry, int);
void* rtcSetNewGeometryBuffer(RTCGeometry, int, unsigned, int, size_t, size_t);
void rtcCommitGeometry(RTCGeometry);
void rtcIntersect1(RTCScene, RTCRayHit*, void*);

}  // extern "C"

namespace {

struct Scene {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  std::atomic<long long> bytes{0};

  ~Scene() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
};

bool count_bytes(void* scene, ssize_t bytes, bool) {
  static_cast<Scene*>(scene)->bytes += bytes;
  return true;
}

}  // namespace

extern "C" {

void* peer_build(const Matter* matter) {
  try {
    auto built = std::make_unique<Scene>();
    // One thread answers; two build.
    built->device = rtcNewDevice("set_affinity=0");
    if (!built->device) return nullptr;
    rtcSetDeviceMemoryMonitorFunction(built->device, count_bytes, built.get());
    built->scene = rtcNewScene(built->device);
    rtcSetSceneBuildQuality(built->scene, RTC_BUILD_QUALITY_HIGH);
    rtcSetSceneFlags(built->scene, RTC_SCENE_FLAG_ROBUST);
    RTCGeometry mesh = rtcNewGeometry(built->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    rtcSetGeometryBuildQuality(mesh, RTC_BUILD_QUALITY_HIGH);
    // Copied into buffers of its own, which it pads.
    auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                                 3 * sizeof(float), matter->vertex_count));
    auto* triangles = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
        mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), matter->triangle_count));
    if (!vertices || !triangles) return nullptr;
    for (size_t n = 0; n < 3 * matter->vertex_count; ++n) vertices[n] = matter->vertices[n];
    for (size_t n = 0; n < 3 * matter->triangle_count; ++n) triangles[n] = matter->triangles[n];
    rtcCommitGeometry(mesh);
    rtcAttachGeometry(built->scene, mesh);
    rtcReleaseGeometry(mesh);
    rtcCommitScene(built->scene);
    return rtcGetDeviceError(built->device) == RTC_ERROR_NONE ? built.release() : nullptr;
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}

void peer_free(void* peer) { delete static_cast<Scene*>(peer); }

int peer_ask(const void* peer, int kind, const double* questions, size_t count, double* answers) {
  if (kind != RAYS) return 0;
  RTCScene scene = static_cast<const Scene*>(peer)->scene;
  for (size_t n = 0; n < count; ++n) {
    const double* q = questions + 7 * n;
    RTCRayHit ray{};
    ray.ray.org_x = static_cast<float>(q[0]);
    ray.ray.org_y = static_cast<float>(q[1]);
    ray.ray.org_z = static_cast<float>(q[2]);
    ray.ray.dir_x = static_cast<float>(q[3]);
    ray.ray.dir_y = static_cast<float>(q[4]);
    ray.ray.dir_z = static_cast<float>(q[5]);
    ray.ray.tfar = static_cast<float>(q[6]);
    ray.ray.mask = ~0u;
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(scene, &ray, nullptr);
    answers[n] = ray.hit.geomID == RTC_INVALID_GEOMETRY_ID ? std::numeric_limits<double>::infinity() : ray.ray.tfar;
  }
  return 1;
}

const char* peer_version() {
  static const std::string version = [] {
    RTCDevice device = rtcNewDevice(nullptr);
    const long number = static_cast<long>(rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION));
    rtcReleaseDevice(device);
    char text[32];
    std::snprintf(text, sizeof text, "%ld.%ld.%ld", number / 10000, number / 100 % 100, number % 100);
    return std::string(text);
  }();
  return version.c_str();
}

size_t peer_file_bytes(const void*, int) { return 0; }

size_t peer_memory_bytes(const void* peer) {
  const long long bytes = static_cast<const Scene*>(peer)->bytes;
  return bytes > 0 ? static_cast<size_t>(bytes) : 0;
}

}  // extern "C"
