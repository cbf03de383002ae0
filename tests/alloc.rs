//! A query allocates nothing, whatever it answers (guarantee G8).

#[path = "oracle/scene.rs"]
#[allow(dead_code)]
mod scene;

use scene::Scene;
use slicewalk::frame::PageKey;
use slicewalk::query::*;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

struct Counting;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: hands every call on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations of this thread while `work` runs.
fn allocations(work: impl FnOnce()) -> u64 {
    let before = COUNT.get();
    work();
    COUNT.get() - before
}

#[test]
fn no_query_allocates() {
    assert!(allocations(|| drop(black_box(vec![1u8]))) > 0, "the counter counts");
    let mut not_loaded = 0;
    for (scene, mut random) in Scene::all().take(30) {
        let some: Vec<PageKey> = scene.pages.iter().map(|page| page.0).filter(|_| random.chance(40)).collect();
        for store in [scene.store(), scene.part(&some)] {
            let boxes: Vec<Aabb> = (0..100).map(|_| scene.random_box(&mut random)).collect();
            let mut answers = vec![Overlap::Clear; boxes.len()];
            let mut probes = vec![Answer::Known(Probe::default()); boxes.len()];
            let count = allocations(|| {
                overlaps_batch(&store, &boxes, &mut answers);
                probe_batch(&store, &boxes, &mut probes);
                for shape in &boxes {
                    let (corner, size) = (shape.min(), shape.max() - shape.min());
                    let sphere = Sphere::new(corner, size.norm() / 2.0).expect("finite");
                    let cylinder = Cylinder::new(corner, size.x, size.z).expect("finite");
                    black_box(overlaps(&store, &sphere));
                    black_box(overlaps(&store, &cylinder));
                    black_box(probe(&store, &sphere));
                    black_box(floor_under(&store, &cylinder, shape.max().z, f64::INFINITY));
                    black_box(ceiling_above(&store, &cylinder, shape.min().z, f64::INFINITY));
                    let way = size + nalgebra::Vector3::new(1e-3, 0.0, 1e-3);
                    black_box(cast(&store, &Ray::new(corner, way, f64::INFINITY).expect("finite")));
                }
            });
            assert_eq!(count, 0);
            not_loaded += answers.iter().filter(|answer| matches!(answer, Overlap::NotLoaded(_))).count();
        }
    }
    assert!(not_loaded > 0, "some pages were missing");
}
