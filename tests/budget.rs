//! A loader's memory stays within its budget: the heap is counted, byte by byte (guarantee G5).

#[path = "common/random.rs"]
mod random;

#[path = "common/heap.rs"]
mod heap;
#[path = "stream/tower.rs"]
mod tower;

use heap::measured;
use slicewalk::archive::Archive;
use slicewalk::bytes::MemorySource;
use slicewalk::store::{Loader, LoaderOptions, Next};
use std::time::Duration;
use tower::{Body, Random};

/// The only test of this file, because others would allocate at the same time.
#[test]
fn the_heap_never_holds_more_than_the_budget() {
    let bytes = tower::tower(4.0, 60.0, 1);
    for (budget, fetches) in [(1 << 20, 1), (2 << 20, 4), (4 << 20, 8)] {
        stays_within(&bytes, budget, fetches);
    }
}

/// Hints at places all over the tower, so that pages are loaded and evicted.
fn stays_within(bytes: &[u8], budget: usize, fetches: usize) {
    let source = MemorySource::new(bytes);
    let (counters, peak) = measured(|| {
        let catalog = Archive::from_source(Box::new(source.clone())).unwrap().catalog().clone();
        let options = LoaderOptions { fetches, ..LoaderOptions::new(budget) };
        let mut loader = Loader::new(catalog, options).unwrap();
        let pawn = loader.body();
        let mut random = Random(budget as u64);
        let (mut flying, mut now) = (Vec::new(), Duration::ZERO);
        for _ in 0..1500 {
            now += Duration::from_millis(20);
            let at = [random.between(-4.0, 4.0), random.between(-4.0, 4.0), random.between(0.0, 60.0)];
            if random.below(10) == 0 {
                loader.hint(pawn, &Body::at(at[0], at[1], at[2]).motion());
            }
            loop {
                match loader.poll(now).unwrap() {
                    Next::Fetch(fetch) => {
                        flying.push((fetch.id, bytes[fetch.range.start as usize..fetch.range.end as usize].to_vec()))
                    }
                    Next::Cancel(cancelled) => flying.retain(|(id, _)| *id != cancelled),
                    Next::Report(report) => panic!("{report:?}"),
                    Next::Wait(_) => break,
                }
            }
            if !flying.is_empty() {
                let (id, bytes) = flying.swap_remove(random.below(flying.len() as u64) as usize);
                let job = loader.given(id, bytes, now);
                job.map(|job| loader.loaded(job.run(), now));
            }
        }
        loader.counters()
    });
    println!("budget {budget}: {peak} bytes at most on the heap, {counters:?}");
    assert!(counters.evicted > 20 && counters.peak_bytes <= budget, "{counters:?}");
    assert!(counters.peak_bytes > budget * 3 / 4, "{counters:?}");
    assert!(peak <= budget, "{peak} bytes on the heap, {budget} allowed");
}
