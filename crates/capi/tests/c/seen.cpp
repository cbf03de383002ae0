// C++17: seen space of the archive argv[1], of argv[2], which has none, and the answers that the table argv[3] expects.
// From where the pawn was seen, it gets to the place argv[4], argv[5], argv[6] over places where it was not.
#include "slicewalk.hpp"

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition); \
            std::exit(1); \
        } \
    } while (0)

int main(int argc, char **argv) {
    using namespace slicewalk;
    CHECK(argc == 7);
    const Archive archive = Archive::file(argv[1]);
    CHECK(!SeenSpace::load(Archive::file(argv[2]), 0));
    const auto seen = SeenSpace::load(archive, 1 << 30);
    CHECK(seen && seen->cells() > 1000);
    const Pages pages = Pages::load(archive);

    // A row has place, direction, longest distance, edge of a box, distance of the hit, and three answers.
    std::ifstream table(argv[3]);
    std::vector<double> places, boxes, rays;
    std::vector<std::uint8_t> expected[3];
    // Streams do not read "inf".
    for (std::string words[12]; table >> words[0];) {
        for (int at = 1; at < 12; at++) table >> words[at];
        const auto number = [&](int at) { return std::strtod(words[at].c_str(), nullptr); };
        for (int axis = 0; axis < 3; axis++) places.push_back(number(axis)), boxes.push_back(number(axis));
        for (int axis = 0; axis < 3; axis++) boxes.push_back(number(axis) + number(7));
        for (int at : {0, 1, 2, 3, 4, 5, 6, 8}) rays.push_back(number(at));
        for (int kind = 0; kind < 3; kind++) expected[kind].push_back(number(9 + kind) != 0);
    }
    CHECK(seen->places(places) == expected[0]);
    CHECK(seen->boxes(boxes) == expected[1]);
    CHECK(seen->rays(rays) == expected[2]);

    CHECK(Route::plan(pages, *seen, {1.5, 3.5, 0.5}, {1.3, 3.3, 0.5}).length() > 0);
    try {
        Route::plan(pages, *seen, {1.5, 3.5, 0.5}, {8.5, 8.8, 0.5});
        CHECK(!"a route leads through unseen space");
    } catch (const Error &error) {
        CHECK(error.status() == SW_ERROR_NO_ROUTE);
    }
    const std::array<double, 3> from{1.5, 3.5, 0.5}, beyond{std::stod(argv[4]), std::stod(argv[5]), std::stod(argv[6]) + 0.1};
    const auto found = Route::blocked(pages, *seen, from, beyond);
    CHECK(found && found->reason == SW_OBSTRUCTION_UNSEEN);
    std::printf("%d rows are the same\n", static_cast<int>(expected[0].size()));
}
