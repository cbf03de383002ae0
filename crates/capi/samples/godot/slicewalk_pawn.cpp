// A node that walks in a slice archive, for godot-cpp. Not run in Godot: see the README of the samples.
#include <gdextension_interface.h>
#include <godot_cpp/classes/engine.hpp>
#include <godot_cpp/classes/input.hpp>
#include <godot_cpp/classes/node3d.hpp>
#include <godot_cpp/core/class_db.hpp>
#include <godot_cpp/godot.hpp>

#include <memory>

#include "slicewalk.hpp"

using namespace godot;

class SlicewalkPawn : public Node3D {
    GDCLASS(SlicewalkPawn, Node3D)

public:
    void set_archive(const String &path) { archive = path; }
    String get_archive() const { return archive; }
    // Place in the scan that is Godot's origin, a vector of doubles (m).
    void set_origin(const PackedFloat64Array &place) { origin = place; }
    PackedFloat64Array get_origin() const { return origin; }

    void _ready() override {
        if (Engine::get_singleton()->is_editor_hint()) return;
        ERR_FAIL_COND_MSG(origin.size() != 3, "origin: expected 3 numbers");
        try {
            auto opened = slicewalk::Archive::file(archive.utf8().get_data());
            auto stream = slicewalk::Stream::open(opened, 256 << 20);
            auto walker = slicewalk::Walker::at(to_scan(get_position()));
            state.reset(new State{std::move(opened), std::move(stream), std::move(walker)});
        } catch (const slicewalk::Error &error) {
            ERR_PRINT(String::utf8(error.what()));
        }
    }

    void _physics_process(double seconds) override {
        if (!state) return;
        const Vector2 wish = Input::get_singleton()->get_vector("ui_left", "ui_right", "ui_down", "ui_up");
        const double way[2] = {wish.x, wish.y};
        sw_step step{};
        step.size = sizeof step;
        if (sw_walker_step_stream(state->walker.get(), state->stream.get(), seconds, SW_DIRECTION, way, &step) != SW_OK) {
            ERR_PRINT(String::utf8(sw_last_error()));
            return;
        }
        set_position(to_godot(step.feet));
    }

protected:
    static void _bind_methods() {
        ClassDB::bind_method(D_METHOD("set_archive", "path"), &SlicewalkPawn::set_archive);
        ClassDB::bind_method(D_METHOD("get_archive"), &SlicewalkPawn::get_archive);
        ADD_PROPERTY(PropertyInfo(Variant::STRING, "archive", PROPERTY_HINT_FILE, "*.slices"), "set_archive", "get_archive");
        ClassDB::bind_method(D_METHOD("set_origin", "place"), &SlicewalkPawn::set_origin);
        ClassDB::bind_method(D_METHOD("get_origin"), &SlicewalkPawn::get_origin);
        ADD_PROPERTY(PropertyInfo(Variant::PACKED_FLOAT64_ARRAY, "origin"), "set_origin", "get_origin");
    }

private:
    // Members are destroyed in reverse order: the walker first.
    struct State {
        slicewalk::Archive archive;
        slicewalk::Stream stream;
        slicewalk::Walker walker;
    };

    // Godot has y up and is right-handed: the scan's y becomes -z.
    std::array<double, 3> to_scan(const Vector3 &place) const {
        return {origin[0] + place.x, origin[1] - place.z, origin[2] + place.y};
    }
    Vector3 to_godot(const double *feet) const {
        return Vector3(feet[0] - origin[0], feet[2] - origin[2], origin[1] - feet[1]);
    }

    String archive = "scan.slices";
    PackedFloat64Array origin{0.0, 0.0, 0.0};
    std::unique_ptr<State> state;
};

static void initialize(ModuleInitializationLevel level) {
    if (level == MODULE_INITIALIZATION_LEVEL_SCENE) ClassDB::register_class<SlicewalkPawn>();
}

static void terminate(ModuleInitializationLevel) {}

extern "C" GDExtensionBool GDE_EXPORT slicewalk_init(
    GDExtensionInterfaceGetProcAddress get, GDExtensionClassLibraryPtr library, GDExtensionInitialization *out) {
    GDExtensionBinding::InitObject init(get, library, out);
    init.register_initializer(initialize);
    init.register_terminator(terminate);
    init.set_minimum_library_initialization_level(MODULE_INITIALIZATION_LEVEL_SCENE);
    return init.init();
}
