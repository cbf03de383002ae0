// Not compiled here: see the README of the samples.
using System.IO;
using UnrealBuildTool;

public class Slicewalk : ModuleRules
{
    public Slicewalk(ReadOnlyTargetRules Target) : base(Target)
    {
        PCHUsage = PCHUsageMode.UseExplicitOrSharedPCHs;
        PublicDependencyModuleNames.AddRange(new[] { "Core", "CoreUObject", "Engine" });
        // slicewalk.hpp reports errors by exceptions.
        bEnableExceptions = true;

        string Folder = Path.Combine(ModuleDirectory, "ThirdParty");
        PublicIncludePaths.Add(Path.Combine(Folder, "include"));
        if (Target.Platform == UnrealTargetPlatform.Win64)
        {
            PublicAdditionalLibraries.Add(Path.Combine(Folder, "lib", "slicewalk.dll.lib"));
            PublicDelayLoadDLLs.Add("slicewalk.dll");
            RuntimeDependencies.Add("$(BinaryOutputDir)/slicewalk.dll", Path.Combine(Folder, "lib", "slicewalk.dll"));
        }
        else
        {
            string Library = Path.Combine(Folder, "lib", "libslicewalk.so");
            PublicAdditionalLibraries.Add(Library);
            RuntimeDependencies.Add(Library);
        }
    }
}
