// Slicewalk for C. Written by cbindgen from crates/capi; do not edit.
//
// Every function returns a status: SW_OK, or an error whose text sw_last_error() returns on the same thread. Results
// come through the last pointers. After an error they are not written, with two exceptions: a batch may hold the
// answers of rows before the refused one, and the place of a new handle holds NULL. All lengths are metres, all
// coordinates are those of the scan, and z is up.
//
// Pointers must not be NULL and must be aligned for their type, unless a text says otherwise. NULL and misaligned
// pointers, lengths that do not match, NaN and handles of another kind are refused with SW_ERROR_ARGUMENT. The caller
// guarantees what cannot be checked: arrays have the stated length, handles are open, and no handle is closed while a
// call uses it.
//
// Threads: any number of threads may use a sw_archive, sw_pages, sw_stream, sw_route or sw_seen at once. A sw_walker
// or a sw_body serves one thread at a time; another thread gets SW_ERROR_BUSY. Each thread has its own sw_last_error().
//
// Structs begin with their size: set it to sizeof before any call, so that a library of another version recognises it.


#ifndef SLICEWALK_H
#define SLICEWALK_H

#include <stddef.h>
#include <stdint.h>

// Answers of overlaps.
enum { SW_CLEAR = 0, SW_HIT = 1, SW_NOT_LOADED = 2 };
// Shapes of a pawn.
enum { SW_BOX = 0, SW_CYLINDER = 1 };
// Move inputs of a walker.
enum { SW_STAY = 0, SW_DIRECTION = 1, SW_TOWARD = 2 };
// States of a walker.
enum { SW_WALKING = 0, SW_FALLING = 1, SW_BLOCKED = 2, SW_ARRIVED = 3 };
// Reasons why a walker stopped short.
enum {
    SW_STOP_NONE = 0, SW_STOP_WALL = 1, SW_STOP_STEEP = 2, SW_STOP_HEADROOM = 3, SW_STOP_CORNER = 4,
    SW_STOP_INSIDE = 5, SW_STOP_LEDGE = 6, SW_STOP_VOID = 7
};
// Reasons why a pawn does not get to its goal.
enum {
    SW_OBSTRUCTION_NONE = 0, SW_OBSTRUCTION_WIDTH = 1, SW_OBSTRUCTION_LENGTH = 2, SW_OBSTRUCTION_HEADROOM = 3,
    SW_OBSTRUCTION_STEP = 4, SW_OBSTRUCTION_SLOPE = 5, SW_OBSTRUCTION_RAMP = 6, SW_OBSTRUCTION_GAP = 7,
    SW_OBSTRUCTION_UNSEEN = 8
};


// Version of this interface. A program runs with a library of the same number as the header that it was compiled with.
#define SW_INTERFACE 1

// Outcome of a call. `sw_last_error` returns the text of an error.
enum sw_status
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Done.
  SW_OK = 0,
  // A pointer, length, handle or number is not allowed.
  SW_ERROR_ARGUMENT = 1,
  // The operating system or a callback refused an action.
  SW_ERROR_IO = 2,
  // The archive is damaged, or the file is not an archive.
  SW_ERROR_FORMAT = 3,
  // A value lies beyond a limit, such as a budget.
  SW_ERROR_LIMIT = 4,
  // The archive uses a feature that this version does not read.
  SW_ERROR_UNSUPPORTED = 5,
  // The answer depends on pages that are not in memory.
  SW_ERROR_NOT_LOADED = 6,
  // No route connects the places, or the pawn cannot stand at one of them.
  SW_ERROR_NO_ROUTE = 7,
  // Another thread is using this walker or body.
  SW_ERROR_BUSY = 8,
  // A defect of the library.
  SW_ERROR_INTERNAL = 9,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum sw_status sw_status;
#else
typedef int32_t sw_status;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// An open archive: head and directory, no pages. Any number of threads may use it at once.
typedef struct sw_archive sw_archive;

// The hints of one moving body. One thread at a time: another one gets `SW_ERROR_BUSY`.
typedef struct sw_body sw_body;

// Pages in memory: all of an archive, or those of a stream at one moment. Any number of threads may use it at once.
typedef struct sw_pages sw_pages;

// A route that a walker can follow. Any number of threads may use it at once.
typedef struct sw_route sw_route;

// Space that the scanners of an archive saw. Any number of threads may use it at once.
//
// Space is divided into cells of 4 × 4 pixels and one slice. A cell is seen only if one station looked through all of
// it; of all other cells nothing is known. The cells of a surface and about two in front of it are never seen.
typedef struct sw_seen sw_seen;

// The pages around moving bodies under a byte budget. Any number of threads may use it at once.
typedef struct sw_stream sw_stream;

// A pawn with gravity, stairs and walls. One thread at a time: another one gets `SW_ERROR_BUSY`.
typedef struct sw_walker sw_walker;

// Source of an archive: functions that read its bytes by ranges.
//
// Slicewalk calls them from any thread, from several at once, and from the threads of its streams, until it calls
// `release`. They must not throw exceptions, and must not call `sw_` functions.
typedef struct sw_source {
  // `sizeof(sw_source)`.
  uint32_t size;
  // Passed to both functions unchanged.
  void *context;
  // Length of the archive (bytes).
  uint64_t length;
  // Fills `buffer` with the `len` bytes at `offset`. Returns 0 on success, any other number on failure.
  int32_t (*read)(void *context, uint64_t offset, uint8_t *buffer, size_t len);
  // Called once after the last `read`, also if opening fails. Not called if this struct is refused for its size. May
  // be NULL.
  void (*release)(void *context);
} sw_source;

// Facts about an archive.
typedef struct sw_info {
  // `sizeof(sw_info)`, set by the caller.
  uint32_t size;
  // 1 if it holds points; otherwise 0, and the bounds are 0.
  uint32_t has_points;
  // Edge of a pixel (m).
  double pixel_size;
  // Height of a slice (m).
  double slice_height;
  // Steps of heights (m).
  double height_quantum;
  // Least coordinates of the scan (m).
  double min[3];
  // Greatest coordinates of the scan (m).
  double max[3];
  // Occupied voxels.
  uint64_t voxels;
  // Length of the archive (bytes).
  uint64_t bytes;
} sw_info;

// Options of a stream.
typedef struct sw_stream_options {
  // `sizeof(sw_stream_options)`.
  uint32_t size;
  // 1: a thread of the library loads pages ahead of the bodies; 0: only `sw_stream_load` loads pages.
  uint32_t prefetch;
  // Memory limit of the stream (bytes).
  uint64_t budget;
} sw_stream_options;

// Result of `sw_stream_load`.
typedef struct sw_loaded {
  // `sizeof(sw_loaded)`, set by the caller.
  uint32_t size;
  // Reserved; 0.
  uint32_t reserved;
  // Pages that were loaded.
  uint64_t loaded;
  // Pages that were in memory already.
  uint64_t already;
  // Pages that did not fit in the budget.
  uint64_t left_out;
  // Budget that the pages of the largest box need (bytes).
  uint64_t needed;
} sw_loaded;

// Shape and abilities of a pawn. `sw_pawn_default` fills it in.
typedef struct sw_pawn {
  // `sizeof(sw_pawn)`, set by the caller.
  uint32_t size;
  // `SW_BOX` or `SW_CYLINDER`.
  uint32_t shape;
  // Width along x; the diameter of a cylinder (m).
  double width;
  // Width along y (m); not used for a cylinder.
  double depth;
  // Height (m).
  double height;
  // Highest step that it climbs (m).
  double climb;
  // Deepest drop that it steps down (m); with infinity, it falls off any ledge.
  double max_drop;
  // Walking speed (m/s).
  double speed;
  // Acceleration downwards (m/s²).
  double gravity;
} sw_pawn;

// Result of a step.
typedef struct sw_step {
  // `sizeof(sw_step)`, set by the caller.
  uint32_t size;
  // State after the step: `SW_WALKING` to `SW_ARRIVED`.
  uint32_t state;
  // Why it stopped short: `SW_STOP_NONE` to `SW_STOP_VOID`.
  uint32_t stop;
  // Ticks of 1/240 s that passed.
  uint32_t ticks;
  // Number of pages that it waits for; `sw_walker_missing` writes their keys.
  uint32_t missing;
  // Ground under it: 0 floor, 1 an obstacle, 2 no ground.
  uint32_t ground;
  // Unused time, because it waits for pages (s). Pass it to the next step, or drop it.
  double unspent;
  // Feet after the step (m).
  double feet[3];
  // Motion of the feet (m).
  double moved[3];
  // Speed downwards (m/s).
  double falling;
} sw_step;

// Obstruction of a pawn: where its best way stops, and the measure that would pass.
typedef struct sw_obstruction {
  // `sizeof(sw_obstruction)`, set by the caller.
  uint32_t size;
  // Reason: `SW_OBSTRUCTION_NONE` to `SW_OBSTRUCTION_UNSEEN`.
  uint32_t reason;
  // The last place that the pawn reaches (m).
  double at[3];
  // The width along the shorter side, the length or the height of the largest pawn that passes with its other measures
  // as they are, or the climb height that passes (m); the grade that passes (rise over run); or the distance to the
  // ground that leads to the goal (m).
  double needs;
} sw_obstruction;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Returns the text of the last failed call on this thread: one line in UTF-8 without a newline, or "" if none failed.
// It stays valid and unchanged until another call fails on the same thread, or the thread ends.
const char *sw_last_error(void);

// Writes the interface version (`SW_INTERFACE`) of the loaded library into `version`.
sw_status sw_interface(uint32_t *version);

// Opens the archive file at `path` (UTF-8).
sw_status sw_open_file(const char *path, struct sw_archive **archive);

// Opens an archive of `len` bytes in memory, and copies them.
sw_status sw_open_memory(const uint8_t *bytes, size_t len, struct sw_archive **archive);

// Opens an archive that the functions in `source` read.
sw_status sw_open_source(const struct sw_source *source, struct sw_archive **archive);

// Writes facts about the archive into `info`.
sw_status sw_archive_info(const struct sw_archive *archive, struct sw_info *info);

// Closes an archive. Pages and streams made from it stay open. NULL is allowed.
sw_status sw_archive_close(struct sw_archive *archive);

// Loads all pages of an archive.
sw_status sw_pages_load(const struct sw_archive *archive, struct sw_pages **pages);

// Closes a set of pages. NULL is allowed.
sw_status sw_pages_close(struct sw_pages *pages);

// Answers whether boxes touch anything solid.
//
// `boxes` holds `boxes_len` = 6 · `count` numbers: xmin, ymin, zmin, xmax, ymax, zmax (m; minima may be -∞, maxima ∞).
// `answers` gets `count` values: `SW_CLEAR`, `SW_HIT`, `SW_NOT_LOADED`.
sw_status sw_overlaps_boxes(const struct sw_pages *pages,
                            const double *boxes,
                            size_t boxes_len,
                            uint8_t *answers,
                            size_t count);

// Answers whether upright cylinders touch anything solid, like `sw_overlaps_boxes`: 5 numbers each, x, y, z of the
// middle of the bottom, radius, height (m).
sw_status sw_overlaps_cylinders(const struct sw_pages *pages,
                                const double *cylinders,
                                size_t cylinders_len,
                                uint8_t *answers,
                                size_t count);

// Answers whether spheres touch anything solid, like `sw_overlaps_boxes`: 4 numbers each, x, y, z of the middle,
// radius (m).
sw_status sw_overlaps_spheres(const struct sw_pages *pages,
                              const double *spheres,
                              size_t spheres_len,
                              uint8_t *answers,
                              size_t count);

// Casts rays: 7 numbers each, x, y, z, direction dx, dy, dz of any length but 0, longest distance (m, may be ∞).
// `distances` gets the distance to the first solid (m), ∞ without a hit, NaN if that depends on missing pages.
sw_status sw_cast_rays(const struct sw_pages *pages,
                       const double *rays,
                       size_t rays_len,
                       double *distances,
                       size_t count);

// Sweeps boxes: 9 numbers each, the box, then its motion dx, dy, dz (m). `fractions` gets the share of the motion up
// to the first contact, 1 without a contact, NaN if that depends on missing pages.
sw_status sw_sweep_boxes(const struct sw_pages *pages,
                         const double *sweeps,
                         size_t sweeps_len,
                         double *fractions,
                         size_t count);

// Finds the highest floor under each box between its zmin and zmax: 6 numbers each. `heights` gets the height (m), -∞
// without a floor, NaN if that depends on missing pages.
sw_status sw_floors(const struct sw_pages *pages,
                    const double *boxes,
                    size_t boxes_len,
                    double *heights,
                    size_t count);

// Finds the lowest ceiling over each box between its zmin and zmax: 6 numbers each. `heights` gets the height (m), ∞
// without a ceiling, NaN if that depends on missing pages.
sw_status sw_ceilings(const struct sw_pages *pages,
                      const double *boxes,
                      size_t boxes_len,
                      double *heights,
                      size_t count);

// Finds the nearest place on the surface of solid space: 4 numbers each, x, y, z of a place, greatest distance (m).
// `answers` gets 7 · `count` numbers: the signed distance (m; above 0 in free space, below 0 inside solid), x, y, z of the
// place on the surface (m), and the unit vector along which the distance grows (zero on the surface). If there is nothing
// that near, the distance is ∞ and the rest NaN; all are NaN if that depends on missing pages.
sw_status sw_nearest_surfaces(const struct sw_pages *pages,
                              const double *places,
                              size_t places_len,
                              double *answers,
                              size_t count);

// Opens a stream on an archive; no page is loaded yet.
sw_status sw_stream_open(const struct sw_archive *archive,
                         const struct sw_stream_options *options,
                         struct sw_stream **stream);

// Creates the set of pages that are in memory now. Never waits. Create one per frame and close it with the frame,
// because pages in a set count against the budget.
sw_status sw_stream_view(const struct sw_stream *stream,
                         struct sw_pages **pages);

// Loads the pages that boxes touch, and waits for them: `boxes_len` numbers, 6 for each box. `report` may be NULL.
sw_status sw_stream_load(const struct sw_stream *stream,
                         const double *boxes,
                         size_t boxes_len,
                         struct sw_loaded *report);

// Loads pages by their keys, 3 numbers each (`sw_walker_missing` writes them), and waits for them. `report` may be NULL.
sw_status sw_stream_load_pages(const struct sw_stream *stream,
                               const int32_t *keys,
                               size_t keys_len,
                               struct sw_loaded *report);

// Waits at most `seconds` until all pages that hints ask for are loaded. `done` gets 1 if they are, else 0.
sw_status sw_stream_settle(const struct sw_stream *stream,
                           double seconds,
                           uint32_t *done);

// Closes a stream and ends its thread. Page sets, bodies and walkers stay open. NULL is allowed.
sw_status sw_stream_close(struct sw_stream *stream);

// Adds a body; the stream loads pages ahead of its motion. Walkers of `sw_walker_step_stream` do not need one.
sw_status sw_body_open(const struct sw_stream *stream,
                       struct sw_body **body);

// Sets how a body moves now: 6 numbers of the box around all queries of a frame (m), and 3 of its velocity (m/s). Call
// it once a frame; it never waits.
sw_status sw_body_hint(const struct sw_body *body,
                       const double *around,
                       const double *velocity);

// Removes a body. NULL is allowed.
sw_status sw_body_close(struct sw_body *body);

// Fills in a pawn of 0.5 × 0.5 × 1.8 m that climbs 0.35 m, walks 1.4 m/s, and falls off any ledge.
sw_status sw_pawn_default(struct sw_pawn *pawn);

// Creates a walker with its feet at `feet`, 3 numbers (m).
sw_status sw_walker_open(const struct sw_pawn *pawn, const double *feet, struct sw_walker **walker);

// Advances the walker by `dt` seconds. `wish` is `SW_STAY`, `SW_DIRECTION` or `SW_TOWARD`, and `to` the two numbers of
// the direction or the place (NULL for `SW_STAY`). The state is `SW_ARRIVED` if it is on its feet at that place. If
// pages are missing, the pawn waits in place and `report` counts them.
sw_status sw_walker_step(const struct sw_walker *walker,
                         const struct sw_pages *pages,
                         double dt,
                         uint32_t wish,
                         const double *to,
                         struct sw_step *report);

// Like `sw_walker_step`, on the pages that a stream has now. It also hints the motion to the stream and asks for
// missing pages, so the pawn continues as soon as they are loaded.
sw_status sw_walker_step_stream(const struct sw_walker *walker,
                                const struct sw_stream *stream,
                                double dt,
                                uint32_t wish,
                                const double *to,
                                struct sw_step *report);

// Writes the keys of the pages that the last step waited for into `keys`, 3 numbers each and at most 16 pages, and the
// number of written numbers into `written`. Keys that do not fit into `keys_len` numbers are left out.
sw_status sw_walker_missing(const struct sw_walker *walker,
                            int32_t *keys,
                            size_t keys_len,
                            size_t *written);

// Moves the walker to `feet`, 3 numbers (m); it rests there.
sw_status sw_walker_place(const struct sw_walker *walker, const double *feet);

// Writes the place of the feet: 3 numbers (m).
sw_status sw_walker_feet(const struct sw_walker *walker, double *feet);

// Removes a walker. NULL is allowed.
sw_status sw_walker_close(struct sw_walker *walker);

// Plans a route of a pawn between two places of 3 numbers (m); a place in the air stands for the floor below it. A
// pawn whose `max_drop` is infinite steps down as far as it climbs. The call returns when the search ends: call it on
// a thread of its own if the program must not wait.
sw_status sw_route_plan(const struct sw_pages *pages,
                        const struct sw_pawn *pawn,
                        const double *from,
                        const double *to,
                        struct sw_route **route);

// Finds what is in the way where `sw_route_plan` with the same arguments returned `SW_ERROR_NO_ROUTE`. The reason is the
// smallest change, relative to the pawn's own measure, that opens a way of at most twice the straight distance plus
// 30 m. It is `SW_OBSTRUCTION_NONE` if the pawn gets to the goal, cannot stand at one of the places, or if nothing was
// found; the numbers are NaN then. Takes up to about 25 times as long as finding all places within that distance.
sw_status sw_route_blocked(const struct sw_pages *pages,
                           const struct sw_pawn *pawn,
                           const double *from,
                           const double *to,
                           struct sw_obstruction *obstruction);

// Writes the length of a route (m) and the number of its points. Either pointer may be NULL.
sw_status sw_route_size(const struct sw_route *route, double *length, size_t *points);

// Writes the points of a route, 3 numbers each (m). `xyz_len` must be 3 times the number of points.
sw_status sw_route_points(const struct sw_route *route, double *xyz, size_t xyz_len);

// Closes a route. NULL is allowed.
sw_status sw_route_close(struct sw_route *route);

// Reads the seen space of an archive. `seen` gets NULL if the archive was written without, so that nothing is known.
// Space that takes more than `memory` bytes is refused with `SW_ERROR_LIMIT`.
sw_status sw_seen_load(const struct sw_archive *archive,
                       uint64_t memory,
                       struct sw_seen **seen);

// Writes the number of seen cells into `cells`.
sw_status sw_seen_cells(const struct sw_seen *seen, uint64_t *cells);

// Answers whether places were seen: 3 numbers each, x, y, z (m). `answers` gets `count` values: 1 if it was, else 0.
sw_status sw_seen_places(const struct sw_seen *seen,
                         const double *places,
                         size_t places_len,
                         uint8_t *answers,
                         size_t count);

// Answers whether all of each box was seen, like `sw_seen_places`: 6 numbers each, as for `sw_overlaps_boxes`. A box that
// is clear and seen is free; one that is clear and not seen may hold solid that was never scanned.
sw_status sw_seen_boxes(const struct sw_seen *seen,
                        const double *boxes,
                        size_t boxes_len,
                        uint8_t *answers,
                        size_t count);

// Answers whether all of each ray was seen, like `sw_seen_places`: 8 numbers each, those of `sw_cast_rays`, then the
// distance that it answered. The ray is followed up to its hit, before which two cells along each axis count as seen,
// or without a hit up to its longest distance. The answer is 0 where the distance is NaN.
sw_status sw_seen_rays(const struct sw_seen *seen,
                       const double *rays,
                       size_t rays_len,
                       uint8_t *answers,
                       size_t count);

// Plans a route like `sw_route_plan`, on which the line through the middle of the pawn was seen, from its climb height
// to its head. All other ground counts as none.
sw_status sw_route_plan_seen(const struct sw_pages *pages,
                             const struct sw_seen *seen,
                             const struct sw_pawn *pawn,
                             const double *from,
                             const double *to,
                             struct sw_route **route);

// Finds what is in the way like `sw_route_blocked`, where `sw_route_plan_seen` returned `SW_ERROR_NO_ROUTE`. If the pawn
// gets to the goal over ground where it was not seen, the reason is `SW_OBSTRUCTION_UNSEEN`.
sw_status sw_route_blocked_seen(const struct sw_pages *pages,
                                const struct sw_seen *seen,
                                const struct sw_pawn *pawn,
                                const double *from,
                                const double *to,
                                struct sw_obstruction *obstruction);

// Closes seen space. NULL is allowed.
sw_status sw_seen_close(struct sw_seen *seen);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SLICEWALK_H */
