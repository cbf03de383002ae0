// A pawn that walks in a slice archive. Not compiled here: see the README of the samples.
#pragma once

#include "CoreMinimal.h"
#include "GameFramework/Pawn.h"

#include <memory>

#include "SlicewalkPawn.generated.h"

UCLASS()
class ASlicewalkPawn : public APawn
{
    GENERATED_BODY()

public:
    ASlicewalkPawn();
    virtual ~ASlicewalkPawn() override;

    UPROPERTY(EditAnywhere, Category = "Slicewalk")
    FString Archive = TEXT("scan.slices");

    // Place in the scan that is Unreal's origin (m).
    UPROPERTY(EditAnywhere, Category = "Slicewalk")
    FVector Origin = FVector::ZeroVector;

    // Memory for pages (bytes).
    UPROPERTY(EditAnywhere, Category = "Slicewalk")
    int64 Budget = 256LL << 20;

    virtual void BeginPlay() override;
    virtual void EndPlay(const EEndPlayReason::Type Reason) override;
    virtual void Tick(float Seconds) override;

private:
    struct FState;
    std::unique_ptr<FState> State;
};
