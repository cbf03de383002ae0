// Slicewalk for C++17: slicewalk.h with objects that close themselves, and exceptions instead of statuses.
//
// The same thread rules as in slicewalk.h. A moved-from object is empty, and every call on it throws.
#ifndef SLICEWALK_HPP
#define SLICEWALK_HPP

#include "slicewalk.h"

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

namespace slicewalk {

// A failed call: its status, and the text of sw_last_error().
class Error : public std::runtime_error {
public:
    explicit Error(sw_status status) : std::runtime_error(sw_last_error()), status_(status) {}
    sw_status status() const noexcept { return status_; }

private:
    sw_status status_;
};

inline void check(sw_status status) {
    if (status != SW_OK) throw Error(status);
}

// Owns a handle.
template <class Handle, sw_status (*Close)(Handle *)>
class Owned {
public:
    Handle *get() const noexcept { return handle_.get(); }

protected:
    Owned() = default;
    explicit Owned(Handle *handle) : handle_(handle) {}

private:
    struct Closer {
        void operator()(Handle *handle) const noexcept { (void)Close(handle); }
    };
    std::unique_ptr<Handle, Closer> handle_;
};

class Archive : public Owned<sw_archive, sw_archive_close> {
public:
    static Archive file(const std::string &path) {
        sw_archive *archive = nullptr;
        check(sw_open_file(path.c_str(), &archive));
        return Archive(archive);
    }
    static Archive memory(const void *bytes, std::size_t len) {
        sw_archive *archive = nullptr;
        check(sw_open_memory(static_cast<const std::uint8_t *>(bytes), len, &archive));
        return Archive(archive);
    }
    static Archive source(const sw_source &source) {
        sw_archive *archive = nullptr;
        check(sw_open_source(&source, &archive));
        return Archive(archive);
    }
    sw_info info() const {
        sw_info info{};
        info.size = sizeof info;
        check(sw_archive_info(get(), &info));
        return info;
    }

private:
    using Owned::Owned;
};

// Pages in memory, and queries on them. Rows are those of slicewalk.h, packed in sequence.
class Pages : public Owned<sw_pages, sw_pages_close> {
public:
    static Pages load(const Archive &archive) {
        sw_pages *pages = nullptr;
        check(sw_pages_load(archive.get(), &pages));
        return Pages(pages);
    }
    std::vector<std::uint8_t> overlaps_boxes(const std::vector<double> &boxes) const {
        return ask<std::uint8_t, 6>(sw_overlaps_boxes, boxes);
    }
    std::vector<std::uint8_t> overlaps_cylinders(const std::vector<double> &cylinders) const {
        return ask<std::uint8_t, 5>(sw_overlaps_cylinders, cylinders);
    }
    std::vector<std::uint8_t> overlaps_spheres(const std::vector<double> &spheres) const {
        return ask<std::uint8_t, 4>(sw_overlaps_spheres, spheres);
    }
    std::vector<double> cast_rays(const std::vector<double> &rays) const { return ask<double, 7>(sw_cast_rays, rays); }
    std::vector<double> sweep_boxes(const std::vector<double> &sweeps) const {
        return ask<double, 9>(sw_sweep_boxes, sweeps);
    }
    std::vector<double> floors(const std::vector<double> &boxes) const { return ask<double, 6>(sw_floors, boxes); }
    std::vector<double> ceilings(const std::vector<double> &boxes) const { return ask<double, 6>(sw_ceilings, boxes); }
    // Seven numbers for each place.
    std::vector<double> nearest_surfaces(const std::vector<double> &places) const {
        std::vector<double> answers(places.size() / 4 * 7);
        check(sw_nearest_surfaces(get(), places.data(), places.size(), answers.data(), places.size() / 4));
        return answers;
    }

private:
    friend class Stream;
    using Owned::Owned;

    template <class Answer, std::size_t N, class Call>
    std::vector<Answer> ask(Call call, const std::vector<double> &rows) const {
        std::vector<Answer> answers(rows.size() / N);
        check(call(get(), rows.data(), rows.size(), answers.data(), answers.size()));
        return answers;
    }
};

// The pages around moving bodies under a byte budget.
class Stream : public Owned<sw_stream, sw_stream_close> {
public:
    static Stream open(const Archive &archive, std::uint64_t budget, bool prefetch = true) {
        sw_stream_options options{};
        options.size = sizeof options;
        options.prefetch = prefetch;
        options.budget = budget;
        sw_stream *stream = nullptr;
        check(sw_stream_open(archive.get(), &options, &stream));
        return Stream(stream);
    }
    Pages view() const {
        sw_pages *pages = nullptr;
        check(sw_stream_view(get(), &pages));
        return Pages(pages);
    }
    sw_loaded load(const std::vector<double> &boxes) const {
        sw_loaded loaded{};
        loaded.size = sizeof loaded;
        check(sw_stream_load(get(), boxes.data(), boxes.size(), &loaded));
        return loaded;
    }
    bool settle(double seconds) const {
        std::uint32_t done = 0;
        check(sw_stream_settle(get(), seconds, &done));
        return done != 0;
    }

private:
    using Owned::Owned;
};

inline sw_pawn default_pawn() {
    sw_pawn pawn{};
    pawn.size = sizeof pawn;
    check(sw_pawn_default(&pawn));
    return pawn;
}

class Walker : public Owned<sw_walker, sw_walker_close> {
public:
    static Walker at(const std::array<double, 3> &feet, const sw_pawn &pawn = default_pawn()) {
        sw_walker *walker = nullptr;
        check(sw_walker_open(&pawn, feet.data(), &walker));
        return Walker(walker);
    }
    sw_step stay(const Pages &pages, double dt) { return step(pages, dt, SW_STAY, nullptr); }
    sw_step direction(const Pages &pages, double dt, const std::array<double, 2> &way) {
        return step(pages, dt, SW_DIRECTION, way.data());
    }
    sw_step toward(const Pages &pages, double dt, const std::array<double, 2> &place) {
        return step(pages, dt, SW_TOWARD, place.data());
    }
    sw_step toward(const Stream &stream, double dt, const std::array<double, 2> &place) {
        sw_step report = empty();
        check(sw_walker_step_stream(get(), stream.get(), dt, SW_TOWARD, place.data(), &report));
        return report;
    }

private:
    using Owned::Owned;

    static sw_step empty() {
        sw_step report{};
        report.size = sizeof report;
        return report;
    }
    sw_step step(const Pages &pages, double dt, std::uint32_t wish, const double *to) {
        sw_step report = empty();
        check(sw_walker_step(get(), pages.get(), dt, wish, to, &report));
        return report;
    }
};

// Space that the scanners saw. Rows are those of slicewalk.h, and so are answers: 1 where all of a row was seen.
class SeenSpace : public Owned<sw_seen, sw_seen_close> {
public:
    // Nothing if the archive was written without seen space.
    static std::optional<SeenSpace> load(const Archive &archive, std::uint64_t memory) {
        sw_seen *seen = nullptr;
        check(sw_seen_load(archive.get(), memory, &seen));
        if (!seen) return std::nullopt;
        return SeenSpace(seen);
    }
    std::uint64_t cells() const {
        std::uint64_t cells = 0;
        check(sw_seen_cells(get(), &cells));
        return cells;
    }
    std::vector<std::uint8_t> places(const std::vector<double> &places) const { return ask<3>(sw_seen_places, places); }
    std::vector<std::uint8_t> boxes(const std::vector<double> &boxes) const { return ask<6>(sw_seen_boxes, boxes); }
    std::vector<std::uint8_t> rays(const std::vector<double> &rays) const { return ask<8>(sw_seen_rays, rays); }

private:
    using Owned::Owned;

    template <std::size_t N, class Call>
    std::vector<std::uint8_t> ask(Call call, const std::vector<double> &rows) const {
        std::vector<std::uint8_t> answers(rows.size() / N);
        check(call(get(), rows.data(), rows.size(), answers.data(), answers.size()));
        return answers;
    }
};

class Route : public Owned<sw_route, sw_route_close> {
public:
    static Route plan(const Pages &pages, const std::array<double, 3> &from, const std::array<double, 3> &to,
                      const sw_pawn &pawn = default_pawn()) {
        sw_route *route = nullptr;
        check(sw_route_plan(pages.get(), &pawn, from.data(), to.data(), &route));
        return Route(route);
    }
    // Stays in seen space.
    static Route plan(const Pages &pages, const SeenSpace &seen, const std::array<double, 3> &from,
                      const std::array<double, 3> &to, const sw_pawn &pawn = default_pawn()) {
        sw_route *route = nullptr;
        check(sw_route_plan_seen(pages.get(), seen.get(), &pawn, from.data(), to.data(), &route));
        return Route(route);
    }
    // What keeps the pawn from its goal where `plan` throws `SW_ERROR_NO_ROUTE`; nothing if nothing was found.
    static std::optional<sw_obstruction> blocked(const Pages &pages, const std::array<double, 3> &from,
                                                 const std::array<double, 3> &to,
                                                 const sw_pawn &pawn = default_pawn()) {
        sw_obstruction found = sized();
        check(sw_route_blocked(pages.get(), &pawn, from.data(), to.data(), &found));
        return some(found);
    }
    // In seen space.
    static std::optional<sw_obstruction> blocked(const Pages &pages, const SeenSpace &seen,
                                                 const std::array<double, 3> &from, const std::array<double, 3> &to,
                                                 const sw_pawn &pawn = default_pawn()) {
        sw_obstruction found = sized();
        check(sw_route_blocked_seen(pages.get(), seen.get(), &pawn, from.data(), to.data(), &found));
        return some(found);
    }
    double length() const {
        double length = 0;
        check(sw_route_size(get(), &length, nullptr));
        return length;
    }
    std::vector<double> points() const {
        std::size_t count = 0;
        check(sw_route_size(get(), nullptr, &count));
        std::vector<double> xyz(3 * count);
        check(sw_route_points(get(), xyz.data(), xyz.size()));
        return xyz;
    }

private:
    using Owned::Owned;

    static sw_obstruction sized() {
        sw_obstruction found{};
        found.size = sizeof found;
        return found;
    }
    static std::optional<sw_obstruction> some(const sw_obstruction &found) {
        if (found.reason == SW_OBSTRUCTION_NONE) return std::nullopt;
        return found;
    }
};

} // namespace slicewalk

#endif
