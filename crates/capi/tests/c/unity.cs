// What the sample for Unity uses of Unity, and a program that runs it: the pawn walks 2.5 m along x in the archive argv[0] from
// the place argv[1], and its end is printed.
using System;
using System.Globalization;
using System.Reflection;
using UnityEngine;

namespace UnityEngine
{
    public struct Vector2
    {
        public float x, y;
        public Vector2(float x, float y) { this.x = x; this.y = y; }
    }

    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
    }

    public sealed class Transform { public Vector3 position; }
    public class MonoBehaviour { public readonly Transform transform = new Transform(); }
    public sealed class TooltipAttribute : Attribute { public TooltipAttribute(string text) { } }
    public static class Time { public static float deltaTime = 1 / 60f; }
    public static class Input { public static float GetAxis(string name) => name == "Horizontal" ? 1 : 0; }
    public static class Debug { public static void Log(object text) { } }
}

public static class Host
{
    public static int Main(string[] arguments)
    {
        var numbers = Array.ConvertAll(arguments[1].Split(' '), text => double.Parse(text, CultureInfo.InvariantCulture));
        var pawn = new SlicewalkPawn { archive = arguments[0], origin = numbers };
        Action<string> call = name =>
            typeof(SlicewalkPawn).GetMethod(name, BindingFlags.NonPublic | BindingFlags.Instance).Invoke(pawn, null);
        call("Start");
        for (var frame = 0; frame < 5000 && pawn.transform.position.x < 2.5f; frame++)
        {
            call("Update");
            // Pages arrive from another thread.
            System.Threading.Thread.Sleep(1);
        }
        var end = pawn.transform.position;
        call("OnDestroy");
        Console.WriteLine(FormattableString.Invariant($"{end.x} {end.y} {end.z}"));
        return 0;
    }
}
