// A pawn that walks in a slice archive. Not run in Unity: see the README of the samples.
using System;
using System.Runtime.InteropServices;
using UnityEngine;

public sealed class SlicewalkPawn : MonoBehaviour
{
    [Tooltip("Path of the archive")] public string archive = "scan.slices";
    [Tooltip("Place in the scan that is Unity's origin: x, y, z (m)")] public double[] origin = { 0, 0, 0 };
    [Tooltip("Memory for pages (bytes)")] public long budget = 256L << 20;

    private IntPtr opened, stream, walker;

    private void Start()
    {
        var pawn = new Pawn { size = (uint)Marshal.SizeOf<Pawn>() };
        var options = new Options { size = (uint)Marshal.SizeOf<Options>(), prefetch = 1, budget = (ulong)budget };
        Check(sw_interface(out var version));
        if (version != 1) throw new InvalidOperationException($"slicewalk: expected interface 1, found {version}");
        Check(sw_open_file(Utf8(archive), out opened));
        Check(sw_stream_open(opened, ref options, out stream));
        Check(sw_pawn_default(ref pawn));
        Check(sw_walker_open(ref pawn, ToScan(transform.position), out walker));
    }

    private void Update()
    {
        // Unity's x and z are the scan's x and y.
        var way = new Vector2(Input.GetAxis("Horizontal"), Input.GetAxis("Vertical"));
        var step = new Step { size = (uint)Marshal.SizeOf<Step>() };
        var to = new double[] { way.x, way.y };
        Check(sw_walker_step_stream(walker, stream, Time.deltaTime, Direction, to, ref step));
        transform.position = ToUnity(step.feetX, step.feetY, step.feetZ);
        if (step.missing > 0) Debug.Log($"slicewalk: waits for {step.missing} pages");
    }

    private void OnDestroy()
    {
        sw_walker_close(walker);
        sw_stream_close(stream);
        sw_archive_close(opened);
    }

    // Unity has y up and is left-handed: the scan's y becomes z.
    private double[] ToScan(Vector3 p) => new[] { origin[0] + p.x, origin[1] + p.z, origin[2] + p.y };

    private Vector3 ToUnity(double x, double y, double z) =>
        new Vector3((float)(x - origin[0]), (float)(z - origin[2]), (float)(y - origin[1]));

    private static void Check(int status)
    {
        if (status != 0) throw new InvalidOperationException(Text(sw_last_error()));
    }

    private static string Text(IntPtr text)
    {
        var length = 0;
        while (Marshal.ReadByte(text, length) != 0) length++;
        var bytes = new byte[length];
        Marshal.Copy(text, bytes, 0, length);
        return System.Text.Encoding.UTF8.GetString(bytes);
    }

    private static byte[] Utf8(string text) => System.Text.Encoding.UTF8.GetBytes(text + "\0");

    private const string Library = "slicewalk";
    private const uint Direction = 1;

    [StructLayout(LayoutKind.Sequential)]
    private struct Options
    {
        public uint size, prefetch;
        public ulong budget;
    }

    [StructLayout(LayoutKind.Sequential)]
    private struct Pawn
    {
        public uint size, shape;
        public double width, depth, height, climb, maxDrop, speed, gravity;
    }

    [StructLayout(LayoutKind.Sequential)]
    private struct Step
    {
        public uint size, state, stop, ticks, missing, ground;
        public double unspent, feetX, feetY, feetZ, movedX, movedY, movedZ, falling;
    }

    [DllImport(Library)] private static extern IntPtr sw_last_error();
    [DllImport(Library)] private static extern int sw_interface(out uint version);
    [DllImport(Library)] private static extern int sw_open_file(byte[] path, out IntPtr archive);
    [DllImport(Library)] private static extern int sw_archive_close(IntPtr archive);
    [DllImport(Library)] private static extern int sw_stream_open(IntPtr archive, ref Options options, out IntPtr stream);
    [DllImport(Library)] private static extern int sw_stream_close(IntPtr stream);
    [DllImport(Library)] private static extern int sw_pawn_default(ref Pawn pawn);
    [DllImport(Library)] private static extern int sw_walker_open(ref Pawn pawn, double[] feet, out IntPtr walker);
    [DllImport(Library)] private static extern int sw_walker_step_stream(
        IntPtr walker, IntPtr stream, double dt, uint wish, double[] to, ref Step step);
    [DllImport(Library)] private static extern int sw_walker_close(IntPtr walker);
}
