// Not compiled here: see the README of the samples.
#include "SlicewalkPawn.h"

#include "Components/SceneComponent.h"
#include "Modules/ModuleManager.h"

#include "slicewalk.hpp"

IMPLEMENT_MODULE(FDefaultModuleImpl, Slicewalk)

DEFINE_LOG_CATEGORY_STATIC(LogSlicewalk, Log, All);

// Members are destroyed in reverse order: the walker first.
struct ASlicewalkPawn::FState
{
    slicewalk::Archive Archive;
    slicewalk::Stream Stream;
    slicewalk::Walker Walker;
};

// Unreal is left-handed and has centimetres: y is mirrored.
static std::array<double, 3> ToScan(const FVector& Place, const FVector& Origin)
{
    return {Origin.X + Place.X / 100, Origin.Y - Place.Y / 100, Origin.Z + Place.Z / 100};
}

static FVector ToUnreal(const double* Feet, const FVector& Origin)
{
    return FVector(Feet[0] - Origin.X, Origin.Y - Feet[1], Feet[2] - Origin.Z) * 100;
}

ASlicewalkPawn::ASlicewalkPawn()
{
    PrimaryActorTick.bCanEverTick = true;
    RootComponent = CreateDefaultSubobject<USceneComponent>(TEXT("Root"));
}

ASlicewalkPawn::~ASlicewalkPawn() = default;

void ASlicewalkPawn::BeginPlay()
{
    Super::BeginPlay();
    try
    {
        auto Opened = slicewalk::Archive::file(TCHAR_TO_UTF8(*Archive));
        auto Stream = slicewalk::Stream::open(Opened, static_cast<std::uint64_t>(Budget));
        auto Walker = slicewalk::Walker::at(ToScan(GetActorLocation(), Origin));
        State.reset(new FState{std::move(Opened), std::move(Stream), std::move(Walker)});
    }
    catch (const slicewalk::Error& Error)
    {
        UE_LOG(LogSlicewalk, Error, TEXT("%s"), UTF8_TO_TCHAR(Error.what()));
    }
}

void ASlicewalkPawn::EndPlay(const EEndPlayReason::Type Reason)
{
    State.reset();
    Super::EndPlay(Reason);
}

void ASlicewalkPawn::Tick(float Seconds)
{
    Super::Tick(Seconds);
    if (!State) return;
    const FVector Wish = ConsumeMovementInputVector();
    sw_step Step{};
    Step.size = sizeof Step;
    const double Way[2] = {Wish.X, -Wish.Y};
    const sw_status Status =
        sw_walker_step_stream(State->Walker.get(), State->Stream.get(), Seconds, SW_DIRECTION, Way, &Step);
    if (Status != SW_OK)
    {
        UE_LOG(LogSlicewalk, Error, TEXT("%s"), UTF8_TO_TCHAR(sw_last_error()));
        return;
    }
    SetActorLocation(ToUnreal(Step.feet, Origin));
}
