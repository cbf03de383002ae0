// C++17: the header slicewalk.hpp on the archive argv[1], walking from argv[2..4] to argv[5..7].
#include "slicewalk.hpp"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <utility>

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition); \
            std::exit(1); \
        } \
    } while (0)

int main(int argc, char **argv) {
    using namespace slicewalk;
    CHECK(argc == 8);
    std::array<double, 3> from{}, to{};
    for (int axis = 0; axis < 3; axis++) from[axis] = std::atof(argv[2 + axis]), to[axis] = std::atof(argv[5 + axis]);

    Archive first = Archive::file(argv[1]);
    Archive archive = std::move(first);
    const sw_info info = archive.info();
    CHECK(info.has_points && info.voxels > 0);
    try {
        first.info();
        CHECK(!"an empty object answers");
    } catch (const Error &error) {
        CHECK(error.status() == SW_ERROR_ARGUMENT && std::string(error.what()).find("sw_archive") == 0);
    }
    try {
        Archive::file("/nonexistent");
        CHECK(!"a missing file opens");
    } catch (const Error &error) {
        CHECK(error.status() == SW_ERROR_IO);
    }

    const Pages pages = Pages::load(archive);
    const std::vector<double> boxes{info.min[0], info.min[1], info.min[2], info.max[0], info.max[1], info.max[2]};
    CHECK(pages.overlaps_boxes(boxes) == std::vector<std::uint8_t>{SW_HIT});
    CHECK(pages.overlaps_boxes({}).empty());
    CHECK(pages.overlaps_spheres({from[0], from[1], from[2], 0.3}) == std::vector<std::uint8_t>{SW_HIT});
    CHECK(std::fabs(pages.cast_rays({from[0], from[1], from[2] + 1, 0, 0, -1, 3}).at(0) - 1) < 0.2);

    // Several threads use one set of pages, and each has its own text.
    std::vector<std::thread> threads;
    for (int thread = 0; thread < 4; thread++) {
        threads.emplace_back([&, thread] {
            for (int round = 0; round < 50; round++) {
                CHECK(pages.overlaps_boxes(boxes).at(0) == SW_HIT);
                CHECK(sw_overlaps_boxes(pages.get(), boxes.data(), thread + 7, nullptr, 1) == SW_ERROR_ARGUMENT);
                CHECK(std::string(sw_last_error()).find("found " + std::to_string(thread + 7)) != std::string::npos);
            }
        });
    }
    for (auto &thread : threads) thread.join();

    const Route route = Route::plan(pages, from, to);
    sw_pawn lame = default_pawn();
    lame.climb = 0.1;
    CHECK(!Route::blocked(pages, from, to));
    CHECK(Route::blocked(pages, from, to, lame).value().reason == SW_OBSTRUCTION_STEP);
    const std::vector<double> xyz = route.points();
    CHECK(route.length() > 0 && xyz.size() >= 6);
    Stream stream = Stream::open(archive, 64 << 20);
    CHECK(stream.load(boxes).left_out == 0);
    CHECK(stream.view().overlaps_boxes(boxes).at(0) == SW_HIT);
    Walker walker = Walker::at(from);
    sw_step step{};
    for (std::size_t next = 1, frames = 0; 3 * next < xyz.size(); frames++) {
        CHECK(frames < 100000);
        step = walker.toward(stream, 1 / 60.0, {xyz[3 * next], xyz[3 * next + 1]});
        if (std::hypot(step.feet[0] - xyz[3 * next], step.feet[1] - xyz[3 * next + 1]) < 0.02) next++;
    }
    CHECK(std::hypot(step.feet[0] - to[0], step.feet[1] - to[1]) < 0.1);
    std::puts("done");
}
