// C99: seen space of the archive argv[1], of argv[2], which has none, and the answers that the table argv[3] expects.
// From where the pawn was seen, it gets to the place argv[4], argv[5], argv[6] over places where it was not.
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
#define REFUSED(call, words) CHECK((call) == SW_ERROR_ARGUMENT && strstr(sw_last_error(), words))

enum { MOST = 1000, COLUMNS = 12 };
static double table[MOST][COLUMNS], places[MOST][3], boxes[MOST][6], rays[MOST][7], ways[MOST][8], hits[MOST];
static uint8_t answers[MOST];

int main(int argc, char **argv) {
    CHECK(argc == 7);
    sw_archive *archive = NULL, *plain = NULL;
    OK(sw_open_file(argv[1], &archive));
    OK(sw_open_file(argv[2], &plain));
    sw_seen *seen = NULL, *none = (sw_seen *)archive;
    OK(sw_seen_load(plain, 0, &none));
    CHECK(none == NULL);
    none = (sw_seen *)archive;
    CHECK(sw_seen_load(archive, 100, &none) == SW_ERROR_LIMIT && none == NULL);
    OK(sw_seen_load(archive, UINT64_MAX, &seen));
    uint64_t cells = 0;
    OK(sw_seen_cells(seen, &cells));
    CHECK(seen != NULL && cells > 1000);

    // A row has place, direction, longest distance, edge of a box, distance of the hit, and three answers.
    FILE *file = fopen(argv[3], "r");
    CHECK(file);
    size_t count = 0, read = 0;
    while (count < MOST && fscanf(file, "%lf", &table[count][read]) == 1) {
        if (++read == COLUMNS) read = 0, count++;
    }
    fclose(file);
    for (size_t row = 0; row < count; row++) {
        for (int axis = 0; axis < 3; axis++) {
            places[row][axis] = boxes[row][axis] = table[row][axis];
            boxes[row][3 + axis] = table[row][axis] + table[row][7];
        }
        memcpy(rays[row], table[row], sizeof rays[row]);
        memcpy(ways[row], table[row], sizeof rays[row]);
    }
    sw_pages *pages = NULL;
    OK(sw_pages_load(archive, &pages));
    OK(sw_cast_rays(pages, rays[0], 7 * count, hits, count));
    for (size_t row = 0; row < count; row++) ways[row][7] = hits[row];
    for (int kind = 0; kind < 3; kind++) {
        OK(kind == 0   ? sw_seen_places(seen, places[0], 3 * count, answers, count)
           : kind == 1 ? sw_seen_boxes(seen, boxes[0], 6 * count, answers, count)
                       : sw_seen_rays(seen, ways[0], 8 * count, answers, count));
        for (size_t row = 0; row < count; row++) CHECK(answers[row] == table[row][9 + kind]);
    }

    // Around the station the pawn was seen, in the hall it was not.
    double from[3] = {1.5, 3.5, 0.5}, near[3] = {1.3, 3.3, 0.5}, hall[3] = {8.5, 8.8, 0.5};
    sw_pawn pawn = {.size = sizeof pawn};
    OK(sw_pawn_default(&pawn));
    sw_route *route = NULL;
    OK(sw_route_plan_seen(pages, seen, &pawn, from, near, &route));
    OK(sw_route_close(route));
    CHECK(sw_route_plan_seen(pages, seen, &pawn, from, hall, &route) == SW_ERROR_NO_ROUTE);
    CHECK(route == NULL && strstr(sw_last_error(), "not_standing_to"));
    sw_obstruction obstruction = {.size = sizeof obstruction};
    OK(sw_route_blocked_seen(pages, seen, &pawn, from, hall, &obstruction));
    CHECK(obstruction.reason == SW_OBSTRUCTION_NONE);
    OK(sw_route_plan(pages, &pawn, from, hall, &route));
    OK(sw_route_close(route));
    double beyond[3] = {strtod(argv[4], NULL), strtod(argv[5], NULL), strtod(argv[6], NULL) + 0.1};
    CHECK(sw_route_plan_seen(pages, seen, &pawn, from, beyond, &route) == SW_ERROR_NO_ROUTE && route == NULL);
    OK(sw_route_blocked_seen(pages, seen, &pawn, from, beyond, &obstruction));
    CHECK(obstruction.reason == SW_OBSTRUCTION_UNSEEN);
    OK(sw_route_plan(pages, &pawn, from, beyond, &route));
    OK(sw_route_close(route));

    // Endless boxes and rays, and refusals.
    double endless[6] = {-INFINITY, 0, 0, INFINITY, 1, 1};
    OK(sw_seen_boxes(seen, endless, 6, answers, 1));
    CHECK(answers[0] == 0);
    double ray[8] = {from[0], from[1], 1.5, 1, 0, 0, INFINITY, INFINITY};
    OK(sw_seen_rays(seen, ray, 8, answers, 1));
    CHECK(answers[0] == 0);
    ray[6] = 0.1;
    OK(sw_seen_rays(seen, ray, 8, answers, 1));
    ray[7] = NAN;
    OK(sw_seen_rays(seen, ray, 8, answers + 1, 1));
    CHECK(answers[0] == 1 && answers[1] == 0);
    ray[7] = -1;
    REFUSED(sw_seen_rays(seen, ray, 8, answers, 1), "row 0");
    endless[1] = 2;
    REFUSED(sw_seen_boxes(seen, endless, 6, answers, 1), "row 0");
    endless[0] = NAN;
    REFUSED(sw_seen_places(seen, endless, 3, answers, 1), "finite");
    REFUSED(sw_seen_places(seen, from, 2, answers, 1), "found 2");
    REFUSED(sw_seen_places(NULL, from, 3, answers, 1), "sw_seen");
    REFUSED(sw_seen_places((sw_seen *)pages, from, 3, answers, 1), "open sw_seen");
    REFUSED(sw_route_plan_seen(pages, NULL, &pawn, from, near, &route), "sw_seen");
    REFUSED(sw_route_blocked_seen(pages, NULL, &pawn, from, near, &obstruction), "sw_seen");
    REFUSED(sw_seen_load(archive, 1, NULL), "NULL");
    REFUSED(sw_seen_cells(seen, NULL), "NULL");

    OK(sw_seen_close(seen));
    OK(sw_seen_close(NULL));
    OK(sw_pages_close(pages));
    OK(sw_archive_close(plain));
    OK(sw_archive_close(archive));
    printf("%d rows are the same\n", (int)count);
    return 0;
}
