// Jolt Physics: the triangles of the boundary as a static mesh; boxes, rays, sweeps, and its character.
//
// As its samples do: one `MeshShape` in a body of its own, the broad phase optimised once, questions through
// `NarrowPhaseQuery`. Four triangles to a leaf, which its documentation gives as the faster choice. Boxes have no convex
// radius, which would round their corners. z is up.

#include "peer.h"

#include <Jolt/Jolt.h>

#include <Jolt/Core/Factory.h>
#include <Jolt/Core/TempAllocator.h>
#include <Jolt/Physics/Body/BodyCreationSettings.h>
#include <Jolt/Physics/Body/BodyInterface.h>
#include <Jolt/Physics/Character/CharacterVirtual.h>
#include <Jolt/Physics/Collision/CastResult.h>
#include <Jolt/Physics/Collision/CollideShape.h>
#include <Jolt/Physics/Collision/CollisionCollectorImpl.h>
#include <Jolt/Physics/Collision/NarrowPhaseQuery.h>
#include <Jolt/Physics/Collision/RayCast.h>
#include <Jolt/Physics/Collision/Shape/BoxShape.h>
#include <Jolt/Physics/Collision/Shape/CapsuleShape.h>
#include <Jolt/Physics/Collision/Shape/MeshShape.h>
#include <Jolt/Physics/Collision/Shape/RotatedTranslatedShape.h>
#include <Jolt/Physics/Collision/ShapeCast.h>
#include <Jolt/Physics/PhysicsSystem.h>
#include <Jolt/RegisterTypes.h>

#include <chrono>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <string>

namespace {

constexpr JPH::ObjectLayer STILL = 0, MOVING = 1;

struct Layers final : JPH::BroadPhaseLayerInterface {
  JPH::uint GetNumBroadPhaseLayers() const override { return 2; }
  JPH::BroadPhaseLayer GetBroadPhaseLayer(JPH::ObjectLayer layer) const override {
    return JPH::BroadPhaseLayer(static_cast<JPH::BroadPhaseLayer::Type>(layer));
  }
#if defined(JPH_EXTERNAL_PROFILE) || defined(JPH_PROFILE_ENABLED)
  const char* GetBroadPhaseLayerName(JPH::BroadPhaseLayer) const override { return "layer"; }
#endif
};

struct LayerPairs final : JPH::ObjectLayerPairFilter {
  bool ShouldCollide(JPH::ObjectLayer a, JPH::ObjectLayer b) const override { return a == MOVING || b == MOVING; }
};

struct BroadPairs final : JPH::ObjectVsBroadPhaseLayerFilter {
  bool ShouldCollide(JPH::ObjectLayer layer, JPH::BroadPhaseLayer broad) const override {
    return layer == MOVING || broad == JPH::BroadPhaseLayer(MOVING);
  }
};

void quiet(const char*, ...) {}

void start_library() {
  static std::once_flag started;
  std::call_once(started, [] {
    JPH::RegisterDefaultAllocator();
    JPH::Trace = quiet;
    JPH::Factory::sInstance = new JPH::Factory();
    JPH::RegisterTypes();
  });
}

struct World {
  Layers layers;
  BroadPairs broad;
  LayerPairs pairs;
  JPH::PhysicsSystem system;
  size_t bytes = 0;
};

JPH::Vec3 vector(const double* v) {
  return JPH::Vec3(static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2]));
}

// A box of the size of a question's, kept for the next one: pawns keep theirs.
class Boxes {
 public:
  const JPH::Shape* of(const double* q, JPH::Vec3& middle) {
    const JPH::Vec3 low = vector(q), high = vector(q + 3);
    middle = 0.5f * (low + high);
    const JPH::Vec3 half = 0.5f * (high - low);
    if (!shape_ || !half.IsClose(half_, 1e-12f)) {
      half_ = half;
      shape_ = new JPH::BoxShape(half, 0.0f);
    }
    return shape_;
  }

 private:
  JPH::Ref<JPH::BoxShape> shape_;
  JPH::Vec3 half_ = JPH::Vec3::sZero();
};

}  // namespace

extern "C" {

void* peer_build(const Matter* matter) {
  start_library();
  auto world = std::make_unique<World>();
  world->system.Init(16, 0, 16, 16, world->layers, world->broad, world->pairs);
  JPH::VertexList vertices;
  vertices.reserve(matter->vertex_count);
  for (size_t n = 0; n < matter->vertex_count; ++n) {
    const float* v = matter->vertices + 3 * n;
    vertices.push_back(JPH::Float3(v[0], v[1], v[2]));
  }
  JPH::IndexedTriangleList triangles;
  triangles.reserve(matter->triangle_count);
  for (size_t n = 0; n < matter->triangle_count; ++n) {
    const uint32_t* t = matter->triangles + 3 * n;
    triangles.push_back(JPH::IndexedTriangle(t[0], t[1], t[2], 0));
  }
  JPH::MeshShapeSettings settings(std::move(vertices), std::move(triangles));
  settings.SetEmbedded();
  settings.mMaxTrianglesPerLeaf = 4;
  const JPH::ShapeSettings::ShapeResult mesh = settings.Create();
  if (mesh.HasError()) return nullptr;
  world->bytes = mesh.Get()->GetStats().mSizeBytes;
  const JPH::BodyCreationSettings body(mesh.Get(), JPH::RVec3::sZero(), JPH::Quat::sIdentity(), JPH::EMotionType::Static,
                                       STILL);
  const JPH::BodyID id = world->system.GetBodyInterface().CreateAndAddBody(body, JPH::EActivation::DontActivate);
  if (id.IsInvalid()) return nullptr;
  world->system.OptimizeBroadPhase();
  return world.release();
}

void peer_free(void* peer) { delete static_cast<World*>(peer); }

int peer_ask(const void* peer, int kind, const double* questions, size_t count, double* answers) {
  const JPH::NarrowPhaseQuery& query = static_cast<const World*>(peer)->system.GetNarrowPhaseQuery();
  Boxes boxes;
  switch (kind) {
    case BOXES: {
      JPH::CollideShapeSettings settings;
      settings.mBackFaceMode = JPH::EBackFaceMode::CollideWithBackFaces;
      for (size_t n = 0; n < count; ++n) {
        JPH::Vec3 middle;
        const JPH::Shape* box = boxes.of(questions + 6 * n, middle);
        JPH::AnyHitCollisionCollector<JPH::CollideShapeCollector> collector;
        query.CollideShape(box, JPH::Vec3::sReplicate(1.0f), JPH::RMat44::sTranslation(JPH::RVec3(middle)), settings,
                           JPH::RVec3(middle), collector);
        answers[n] = collector.HadHit() ? 1.0 : 0.0;
      }
      return 1;
    }
    case RAYS:
      for (size_t n = 0; n < count; ++n) {
        const double* q = questions + 7 * n;
        const JPH::RRayCast ray(JPH::RVec3(vector(q)), vector(q + 3) * static_cast<float>(q[6]));
        JPH::RayCastResult hit;
        answers[n] = query.CastRay(ray, hit) ? hit.mFraction * q[6] : std::numeric_limits<double>::infinity();
      }
      return 1;
    case SWEEPS: {
      JPH::ShapeCastSettings settings;
      settings.mBackFaceModeTriangles = JPH::EBackFaceMode::CollideWithBackFaces;
      for (size_t n = 0; n < count; ++n) {
        const double* q = questions + 9 * n;
        JPH::Vec3 middle;
        const JPH::Shape* box = boxes.of(q, middle);
        const JPH::Vec3 way = vector(q + 6);
        const JPH::RShapeCast cast(box, JPH::Vec3::sReplicate(1.0f), JPH::RMat44::sTranslation(JPH::RVec3(middle)), way);
        JPH::ClosestHitCollisionCollector<JPH::CastShapeCollector> collector;
        query.CastShape(cast, settings, JPH::RVec3(middle), collector);
        answers[n] = (collector.HadHit() ? collector.mHit.mFraction : 1.0) * std::hypot(q[6], q[7], q[8]);
      }
      return 1;
    }
    default:
      return 0;
  }
}

const char* peer_version() {
  static const std::string version = std::to_string(JPH_VERSION_MAJOR) + "." + std::to_string(JPH_VERSION_MINOR) + "." +
                                     std::to_string(JPH_VERSION_PATCH);
  return version.c_str();
}

size_t peer_file_bytes(const void*, int) { return 0; }

size_t peer_memory_bytes(const void* peer) { return static_cast<const World*>(peer)->bytes; }

// Walks a `CharacterVirtual` for some frames of 1/60 s: a capsule that wants to go with a velocity x y (m/s) and falls.
// Writes the feet x y z after each frame (m), and how long the frame took (ns). As the sample of the character does it:
// velocity from ground and gravity, then `ExtendedUpdate` with its defaults, but for the height of steps.
void jolt_walk(const void* peer, const double* start, const double* velocity, double radius, double height, double climb,
               size_t frames, double* feet, double* times) {
  // A question to the world does not change it, but the character wants it whole.
  auto& system = const_cast<World*>(static_cast<const World*>(peer))->system;
  constexpr float FRAME = 1.0f / 60.0f;
  const JPH::Vec3 up = JPH::Vec3::sAxisZ(), gravity(0.0f, 0.0f, -9.81f);
  const float r = static_cast<float>(radius), half = static_cast<float>(height) / 2.0f;
  const JPH::Ref<JPH::Shape> capsule = new JPH::CapsuleShape(half - r, r);
  JPH::Ref<JPH::CharacterVirtualSettings> settings = new JPH::CharacterVirtualSettings();
  settings->mUp = up;
  settings->mShape = JPH::RotatedTranslatedShapeSettings(JPH::Vec3(0.0f, 0.0f, half),
                                                         JPH::Quat::sRotation(JPH::Vec3::sAxisX(), 0.5f * JPH::JPH_PI), capsule)
                         .Create()
                         .Get();
  settings->mMaxSlopeAngle = JPH::DegreesToRadians(45.0f);
  settings->mSupportingVolume = JPH::Plane(up, -r);
  const float lift = settings->mCharacterPadding;
  JPH::Ref<JPH::CharacterVirtual> character = new JPH::CharacterVirtual(
      settings, JPH::RVec3(vector(start) + lift * up), JPH::Quat::sIdentity(), &system);
  JPH::CharacterVirtual::ExtendedUpdateSettings update;
  update.mStickToFloorStepDown = -static_cast<float>(climb) * up;
  update.mWalkStairsStepUp = static_cast<float>(climb) * up;
  JPH::TempAllocatorImpl scratch(16 << 20);
  const JPH::Vec3 wanted(static_cast<float>(velocity[0]), static_cast<float>(velocity[1]), 0.0f);
  for (size_t n = 0; n < frames; ++n) {
    const auto begin = std::chrono::steady_clock::now();
    character->UpdateGroundVelocity();
    const JPH::Vec3 falling = character->GetLinearVelocity().Dot(up) * up;
    const JPH::Vec3 ground = character->GetGroundVelocity();
    const bool rests = character->GetGroundState() == JPH::CharacterVirtual::EGroundState::OnGround &&
                       (falling - ground).Dot(up) < 0.1f;
    character->SetLinearVelocity((rests ? ground : falling) + gravity * FRAME + wanted);
    character->ExtendedUpdate(FRAME, gravity, update, system.GetDefaultBroadPhaseLayerFilter(MOVING),
                              system.GetDefaultLayerFilter(MOVING), {}, {}, scratch);
    times[n] = std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - begin).count();
    const JPH::RVec3 place = character->GetPosition();
    for (int axis = 0; axis < 3; ++axis) feet[3 * n + axis] = place[axis];
  }
}

}  // extern "C"
