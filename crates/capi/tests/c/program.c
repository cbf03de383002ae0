// C99: every group of functions on the archive argv[1], walking from argv[2..4] to argv[5..7], and every refusal.
#include "slicewalk.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "%s:%d: %s: %s\n", __FILE__, __LINE__, #condition, sw_last_error()); \
            exit(1); \
        } \
    } while (0)
#define OK(call) CHECK((call) == SW_OK)
// The call is refused, and the text says why.
#define REFUSED(call, words) CHECK((call) == SW_ERROR_ARGUMENT && strstr(sw_last_error(), words))
// The call is refused, and leaves NULL in the place of its new handle, `made`.
#define LEAVES_NULL(type, call) \
    do { \
        type *made = (type *)archive; \
        REFUSED(call, ""); \
        CHECK(made == NULL); \
    } while (0)

struct file {
    FILE *file;
    int released;
};

static int32_t read_range(void *context, uint64_t offset, uint8_t *buffer, size_t len) {
    struct file *source = context;
    return fseek(source->file, (long)offset, SEEK_SET) != 0 || fread(buffer, 1, len, source->file) != len;
}

static int32_t read_nothing(void *context, uint64_t offset, uint8_t *buffer, size_t len) {
    (void)context, (void)offset, (void)buffer, (void)len;
    return 7;
}

static void release(void *context) { ((struct file *)context)->released++; }

int main(int argc, char **argv) {
    CHECK(argc == 8);
    double from[3], to[3];
    for (int axis = 0; axis < 3; axis++) {
        from[axis] = atof(argv[2 + axis]);
        to[axis] = atof(argv[5 + axis]);
    }
    uint32_t version = 0;
    OK(sw_interface(&version));
    CHECK(version == SW_INTERFACE && sw_last_error()[0] == 0);

    // Opening: a file, memory, callbacks.
    sw_archive *archive = NULL, *copy = NULL, *ranges = NULL;
    OK(sw_open_file(argv[1], &archive));
    struct file source = {fopen(argv[1], "rb"), 0};
    CHECK(source.file && fseek(source.file, 0, SEEK_END) == 0);
    size_t len = (size_t)ftell(source.file);
    uint8_t *bytes = malloc(len);
    CHECK(read_range(&source, 0, bytes, len) == 0);
    OK(sw_open_memory(bytes, len, &copy));
    sw_source functions = {sizeof functions, &source, len, read_range, release};
    OK(sw_open_source(&functions, &ranges));
    sw_info info = {.size = sizeof info}, other = {.size = sizeof other};
    OK(sw_archive_info(archive, &info));
    OK(sw_archive_info(ranges, &other));
    CHECK(info.has_points && info.bytes == len && info.voxels == other.voxels && info.pixel_size > 0);
    bytes[len / 2] ^= 1;
    free(bytes);

    // All pages and each kind of question.
    sw_pages *pages = NULL, *same = NULL;
    OK(sw_pages_load(archive, &pages));
    OK(sw_pages_load(ranges, &same));
    double boxes[12];
    memcpy(boxes, info.min, sizeof info.min);
    memcpy(boxes + 3, info.max, sizeof info.max);
    memcpy(boxes + 6, info.max, sizeof info.max);
    for (int axis = 0; axis < 3; axis++) boxes[6 + axis] += 10, boxes[9 + axis] = info.max[axis] + 11;
    uint8_t hits[2] = {9, 9}, again[2] = {9, 9};
    OK(sw_overlaps_boxes(pages, boxes, 12, hits, 2));
    OK(sw_overlaps_boxes(same, boxes, 12, again, 2));
    CHECK(hits[0] == SW_HIT && hits[1] == SW_CLEAR && memcmp(hits, again, 2) == 0);
    double ball[4] = {from[0], from[1], from[2], 0.3}, drum[5] = {from[0], from[1], from[2] - 0.1, 0.2, 1.0};
    OK(sw_overlaps_spheres(pages, ball, 4, hits, 1));
    OK(sw_overlaps_cylinders(pages, drum, 5, hits + 1, 1));
    CHECK(hits[0] == SW_HIT && hits[1] == SW_HIT);
    double down[7] = {from[0], from[1], from[2] + 1, 0, 0, -2, INFINITY}, up[7] = {from[0], from[1], info.max[2] + 1, 0, 0, 1, 5};
    double distance[1], fraction[1], height[1];
    OK(sw_cast_rays(pages, down, 7, distance, 1));
    CHECK(fabs(distance[0] - 1) < 0.2);
    OK(sw_cast_rays(pages, up, 7, distance, 1));
    CHECK(isinf(distance[0]));
    double sweep[9] = {from[0] - 0.2, from[1] - 0.2, from[2] + 1, from[0] + 0.2, from[1] + 0.2, from[2] + 1.5, 0, 0, -2};
    OK(sw_sweep_boxes(pages, sweep, 9, fraction, 1));
    CHECK(fabs(fraction[0] - 0.5) < 0.1);
    double under[6] = {from[0] - 0.2, from[1] - 0.2, from[2] - 1, from[0] + 0.2, from[1] + 0.2, from[2] + 1};
    OK(sw_floors(pages, under, 6, height, 1));
    CHECK(fabs(height[0] - from[2]) < 0.2);
    // The floor that was found lies in the box that begins at its height.
    double on_floor[6] = {under[0], under[1], height[0], under[3], under[4], under[5]}, same_height[1];
    OK(sw_floors(pages, on_floor, 6, same_height, 1));
    CHECK(same_height[0] == height[0]);
    under[2] = info.max[2] + 1, under[5] = INFINITY;
    OK(sw_ceilings(pages, under, 6, height, 1));
    CHECK(isinf(height[0]) && height[0] > 0);
    double place[4] = {from[0], from[1], from[2] + 0.5, 1}, surface[7];
    OK(sw_nearest_surfaces(pages, place, 4, surface, 1));
    CHECK(surface[0] > 0.1 && surface[0] < 0.6);
    for (int i = 0; i < 3; i++) CHECK(fabs(place[i] - surface[0] * surface[4 + i] - surface[1 + i]) < 1e-9);
    place[2] = info.max[2] + 9;
    OK(sw_nearest_surfaces(pages, place, 4, surface, 1));
    CHECK(isinf(surface[0]) && isnan(surface[1]) && isnan(surface[6]));
    OK(sw_overlaps_boxes(pages, NULL, 0, NULL, 0));

    // A route, and a walker along it, on all pages and on a stream.
    sw_pawn pawn = {.size = sizeof pawn};
    OK(sw_pawn_default(&pawn));
    sw_route *route = NULL;
    OK(sw_route_plan(pages, &pawn, from, to, &route));
    double length = 0;
    size_t count = 0, written = 0;
    OK(sw_route_size(route, &length, &count));
    CHECK(count >= 2 && length >= hypot(to[0] - from[0], to[1] - from[1]) - 0.2);
    double *xyz = malloc(3 * count * sizeof *xyz);
    REFUSED(sw_route_points(route, xyz, 3 * count - 1), "xyz");
    OK(sw_route_points(route, xyz, 3 * count));
    // Nothing loads ahead of the first walk, so the walker must wait.
    sw_stream_options options = {sizeof options, 0, 64 << 20};
    sw_stream *on_demand = NULL, *stream = NULL;
    OK(sw_stream_open(ranges, &options, &on_demand));
    options.prefetch = 1;
    OK(sw_stream_open(ranges, &options, &stream));
    options.prefetch = 2;
    sw_stream *refused = stream;
    REFUSED(sw_stream_open(ranges, &options, &refused), "prefetch");
    double ends[2][3];
    for (int streaming = 0; streaming < 2; streaming++) {
        sw_walker *walker = NULL;
        sw_step step = {.size = sizeof step};
        OK(sw_walker_open(&pawn, xyz, &walker));
        int waited = 0;
        for (size_t next = 1, frames = 0; next < count; frames++) {
            CHECK(frames < 100000);
            double dt = 1 / 60.0;
            OK(streaming ? sw_walker_step_stream(walker, on_demand, dt, SW_TOWARD, xyz + 3 * next, &step)
                         : sw_walker_step(walker, pages, dt, SW_TOWARD, xyz + 3 * next, &step));
            if (step.missing > 0) {
                int32_t keys[48];
                sw_loaded loaded = {.size = sizeof loaded};
                OK(sw_walker_missing(walker, keys, 48, &written));
                CHECK(streaming && written >= 3 && written % 3 == 0);
                OK(sw_stream_load_pages(on_demand, keys, written, &loaded));
                CHECK(loaded.left_out == 0);
                waited = 1;
            }
            if (hypot(step.feet[0] - xyz[3 * next], step.feet[1] - xyz[3 * next + 1]) < 0.02) next++;
        }
        CHECK(waited == streaming);
        for (int frames = 0; step.state != SW_ARRIVED; frames++) {
            CHECK(frames < 10 && step.state == SW_WALKING);
            OK(sw_walker_step(walker, pages, 1 / 60.0, SW_TOWARD, xyz + 3 * (count - 1), &step));
        }
        OK(sw_walker_step(walker, pages, 1 / 60.0, SW_STAY, NULL, &step));
        CHECK(step.state == SW_WALKING);
        OK(sw_walker_feet(walker, ends[streaming]));
        CHECK(hypot(ends[streaming][0] - to[0], ends[streaming][1] - to[1]) < 0.1);
        OK(sw_walker_place(walker, from));
        REFUSED(sw_walker_step(walker, pages, NAN, SW_STAY, NULL, &step), "dt");
        REFUSED(sw_walker_step(walker, pages, 0.1, 9, NULL, &step), "wish");
        REFUSED(sw_walker_step(walker, pages, 0.1, SW_TOWARD, NULL, &step), "NULL");
        // A step whose report does not fit is refused before it moves the pawn.
        sw_step unsized_step = {.size = 8};
        REFUSED(sw_walker_step(walker, pages, 0.5, SW_TOWARD, to, &unsized_step), "sw_step.size");
        REFUSED(sw_walker_step(walker, pages, 0.5, SW_TOWARD, to, NULL), "NULL");
        REFUSED(sw_walker_step_stream(walker, on_demand, 0.5, SW_TOWARD, to, &unsized_step), "sw_step.size");
        double feet[3];
        OK(sw_walker_feet(walker, feet));
        CHECK(memcmp(feet, from, sizeof feet) == 0);
        OK(sw_walker_step(walker, pages, 0.1, SW_STAY, NULL, &step));
        OK(sw_walker_close(walker));
    }
    sw_body *body = NULL;
    uint32_t done = 0;
    double velocity[3] = {1, 0, 0};
    OK(sw_body_open(stream, &body));
    OK(sw_body_hint(body, boxes, velocity));
    OK(sw_stream_settle(stream, 20, &done));
    sw_loaded loaded = {.size = sizeof loaded};
    OK(sw_stream_load(stream, boxes, 6, &loaded));
    sw_loaded unsized_load = {.size = 8};
    REFUSED(sw_stream_load(stream, boxes, 6, &unsized_load), "sw_loaded.size");
    CHECK(done == 1 && loaded.left_out == 0 && loaded.loaded + loaded.already > 0);
    sw_pages *view = NULL;
    OK(sw_stream_view(stream, &view));
    OK(sw_overlaps_boxes(view, boxes, 6, hits, 1));
    CHECK(hits[0] == SW_HIT);

    // Pages that are not in memory.
    sw_stream_options lazy = {sizeof lazy, 0, 64 << 20};
    sw_stream *empty = NULL;
    sw_pages *nothing = NULL;
    OK(sw_stream_open(archive, &lazy, &empty));
    OK(sw_stream_view(empty, &nothing));
    OK(sw_overlaps_boxes(nothing, boxes, 6, hits, 1));
    OK(sw_cast_rays(nothing, down, 7, distance, 1));
    CHECK(hits[0] == SW_NOT_LOADED && isnan(distance[0]));
    sw_route *none = route;
    CHECK(sw_route_plan(nothing, &pawn, from, to, &none) == SW_ERROR_NOT_LOADED && none == NULL);
    double sky[3] = {to[0] + 1e5, to[1], to[2]};
    CHECK(sw_route_plan(pages, &pawn, from, sky, &none) == SW_ERROR_NO_ROUTE && strstr(sw_last_error(), "not_standing_to"));

    // What is in the way: nothing, or steps of 0.17 m.
    sw_obstruction obstruction = {.size = sizeof obstruction};
    OK(sw_route_blocked(pages, &pawn, from, to, &obstruction));
    CHECK(obstruction.reason == SW_OBSTRUCTION_NONE && isnan(obstruction.needs) && isnan(obstruction.at[0]));
    OK(sw_route_blocked(pages, &pawn, from, sky, &obstruction));
    CHECK(obstruction.reason == SW_OBSTRUCTION_NONE);
    sw_pawn lame = pawn;
    lame.climb = 0.1;
    CHECK(sw_route_plan(pages, &lame, from, to, &none) == SW_ERROR_NO_ROUTE && strstr(sw_last_error(), "not_connected"));
    OK(sw_route_blocked(pages, &lame, from, to, &obstruction));
    CHECK(obstruction.reason == SW_OBSTRUCTION_STEP && fabs(obstruction.needs - 0.17) < 0.02);
    CHECK(fabs(obstruction.at[2] - from[2]) < 0.2 && obstruction.at[0] > from[0] - 0.5 && obstruction.at[0] < to[0]);
    lame.climb = obstruction.needs;
    OK(sw_route_plan(pages, &lame, from, to, &none));
    OK(sw_route_close(none));
    CHECK(sw_route_blocked(nothing, &lame, from, to, &obstruction) == SW_ERROR_NOT_LOADED);
    REFUSED(sw_route_blocked(NULL, &lame, from, to, &obstruction), "sw_pages");
    REFUSED(sw_route_blocked(pages, &lame, from, to, NULL), "sw_obstruction");
    obstruction.size = 4;
    REFUSED(sw_route_blocked(pages, &lame, from, to, &obstruction), "sizeof(sw_obstruction)");
    lame.climb = 5;
    obstruction.size = sizeof obstruction;
    REFUSED(sw_route_blocked(pages, &lame, from, to, &obstruction), "climb");
    lazy.budget = 1;
    sw_stream *tight = NULL;
    CHECK(sw_stream_open(archive, &lazy, &tight) == SW_ERROR_ARGUMENT && tight == NULL);

    // Refusals: null, misaligned, wrong lengths, NaN, overlap, other kinds of handles, sizes of structs.
    REFUSED(sw_overlaps_boxes(NULL, boxes, 12, hits, 2), "sw_pages");
    REFUSED(sw_overlaps_boxes(pages, NULL, 12, hits, 2), "NULL");
    REFUSED(sw_overlaps_boxes(pages, boxes, 12, NULL, 2), "NULL");
    REFUSED(sw_overlaps_boxes(pages, boxes, 11, hits, 2), "found 11");
    REFUSED(sw_overlaps_boxes(pages, boxes, 0, hits, SIZE_MAX), "found 0");
    REFUSED(sw_overlaps_boxes(pages, (double *)((uintptr_t)boxes + 1), 6, hits, 1), "multiple of 8");
    REFUSED(sw_overlaps_boxes(pages, boxes, 6, (uint8_t *)boxes, 1), "overlap");
    REFUSED(sw_overlaps_boxes((sw_pages *)archive, boxes, 6, hits, 1), "open sw_pages");
    boxes[6] = NAN;
    REFUSED(sw_overlaps_boxes(pages, boxes, 12, hits, 2), "row 1");
    REFUSED(sw_floors(pages, boxes + 6, 6, height, 1), "row 0");
    place[3] = -1;
    REFUSED(sw_nearest_surfaces(pages, place, 4, surface, 1), "at least 0");
    REFUSED(sw_nearest_surfaces(pages, place, 4, place, 1), "overlap");
    down[5] = 0;
    REFUSED(sw_cast_rays(pages, down, 7, distance, 1), "row 0");
    sweep[8] = NAN;
    REFUSED(sw_sweep_boxes(pages, sweep, 9, fraction, 1), "motion");
    ball[3] = -1;
    REFUSED(sw_overlaps_spheres(pages, ball, 4, hits, 1), "row 0");
    REFUSED(sw_archive_info(archive, NULL), "sw_info");
    info.size = 8;
    REFUSED(sw_archive_info(archive, &info), "sizeof(sw_info)");
    from[0] = NAN;
    sw_walker *walker = NULL;
    REFUSED(sw_walker_open(&pawn, from, &walker), "feet");
    pawn.shape = 5;
    REFUSED(sw_walker_open(&pawn, to, &walker), "shape");
    sw_archive *missing = archive;
    CHECK(sw_open_file("/nonexistent", &missing) == SW_ERROR_IO && missing == NULL);
    REFUSED(sw_open_file(argv[1], NULL), "NULL");
    REFUSED(sw_open_file("\xff", &missing), "UTF-8");
    CHECK(sw_open_memory((const uint8_t *)"no archive", 10, &missing) != SW_OK && missing == NULL);
    struct file failing = {NULL, 0};
    sw_source broken = {sizeof broken, &failing, 1000, read_nothing, release};
    CHECK(sw_open_source(&broken, &missing) == SW_ERROR_IO && strstr(sw_last_error(), "returned 7"));
    CHECK(failing.released == 1);
    REFUSED(sw_open_source(&broken, NULL), "NULL");
    CHECK(failing.released == 2);
    LEAVES_NULL(sw_archive, sw_open_file(NULL, &made));
    LEAVES_NULL(sw_archive, sw_open_memory(NULL, 10, &made));
    LEAVES_NULL(sw_archive, sw_open_source(NULL, &made));
    LEAVES_NULL(sw_pages, sw_pages_load(NULL, &made));
    LEAVES_NULL(sw_stream, sw_stream_open(NULL, &lazy, &made));
    LEAVES_NULL(sw_pages, sw_stream_view(NULL, &made));
    LEAVES_NULL(sw_body, sw_body_open(NULL, &made));
    LEAVES_NULL(sw_walker, sw_walker_open(NULL, to, &made));
    LEAVES_NULL(sw_route, sw_route_plan(NULL, &pawn, to, to, &made));
    LEAVES_NULL(sw_seen, sw_seen_load(NULL, 0, &made));
    LEAVES_NULL(sw_route, sw_route_plan_seen(pages, NULL, &pawn, to, to, &made));

    OK(sw_body_close(body));
    OK(sw_pages_close(view));
    OK(sw_stream_close(stream));
    OK(sw_stream_close(on_demand));
    OK(sw_pages_close(nothing));
    OK(sw_stream_close(empty));
    OK(sw_route_close(route));
    OK(sw_pages_close(pages));
    OK(sw_archive_close(archive));
    OK(sw_archive_close(copy));
    CHECK(source.released == 0);
    OK(sw_archive_close(ranges));
    OK(sw_pages_close(same));
    CHECK(source.released == 1);
    OK(sw_archive_close(NULL));
    fclose(source.file);
    free(xyz);
    puts("done");
    return 0;
}
