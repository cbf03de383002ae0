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
use slicewalk::codec::{Decoder, Encoder};
use slicewalk::frame::Frame;
use slicewalk::page::{Inferred, PageBuilder, Span};
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
    for most in [1, 9, 64] {
        decodes_within(most);
    }
}

/// Decodes a page with `most` spans in each pixel, some of them inferred, and takes these out.
fn decodes_within(most: u32) {
    let (mut builder, mut inferred, mut body) = (PageBuilder::default(), Inferred::new(), Vec::new());
    for pixel in 0..64 * 64 {
        let (px, py) = (pixel % 64, pixel / 64);
        let span = |k| Span::new(255 * k + (px * 31 + py * 57) % 200, 255 * k + 200 + px % 50, false).unwrap();
        assert!(builder.set_column(px, py, &(0..most).map(span).collect::<Vec<_>>()));
        assert!(inferred.push(px, py, u64::from(pixel % 2)));
    }
    let page = builder.build();
    Encoder::new(Frame::new(0.05, 0.15).unwrap(), 0).encode_inferred(&page, &inferred, &mut body);
    let spans = page.span_count();
    drop(builder);
    let (rest, peak) = measured(|| {
        let mut decoder = Decoder::for_spans(spans);
        let page = decoder.decode(&body).unwrap();
        let mut builder = PageBuilder::default();
        builder.reserve(spans);
        decoder.inferred().without(&page, &mut builder)
    });
    let scratch = Decoder::scratch_bytes(spans) + PageBuilder::scratch_bytes(spans);
    let stated = scratch + page.weight_bytes() + rest.weight_bytes();
    println!("{most} spans a pixel: {peak} bytes at most on the heap, {stated} stated");
    assert!((stated * 2 / 3..=stated).contains(&peak), "{peak} of {stated} bytes");
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
