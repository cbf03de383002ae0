//! Answers of the device, each compared with the processor's.
//!
//! `SLICEWALK_GPU_ANSWERS` sets how many of each kind are compared.

mod common;

use common::{Asker, Scene as Pages, converted, data, device, generated, partly_loaded, random_pages};
use slicewalk::query::{RayHit, Shape, cast, floor_under, overlaps};
use slicewalk_gpu::{Device, Question, Replies, Reply, Scene};
use std::fmt::Debug;

/// Answers of each kind that are compared, in all scenes together.
fn wanted() -> usize {
    std::env::var("SLICEWALK_GPU_ANSWERS").map_or(20_000, |count| count.parse().unwrap())
}

/// Number of questions, and of those that the processor had to answer, by kind.
#[derive(Default)]
struct Tally([[usize; 3]; 5]);

const KINDS: [&str; 5] = ["boxes", "cylinders", "spheres", "floors", "rays"];

impl Tally {
    fn add<T>(&mut self, kind: usize, replies: &Replies<T>, positive: impl Fn(&T) -> bool) {
        let positive = |reply: &&Reply<T>| matches!(reply, Reply::Known(answer) if positive(answer));
        let [all, by_processor, hits] = &mut self.0[kind];
        *all += replies.answers.len();
        *by_processor += replies.by_processor;
        *hits += replies.answers.iter().filter(positive).count();
    }
}

/// Sends a batch and waits for its answers.
fn ask<Q: Question>(scene: &Scene, questions: &[Q]) -> Replies<Q::Answer> {
    let replies = scene.ask(questions).unwrap().wait().unwrap();
    assert_eq!(replies.answers.len(), questions.len());
    replies
}

/// Distances with all of their bits, which `==` does not compare.
fn bits(reply: &Reply<Option<RayHit>>) -> Option<u64> {
    match reply {
        Reply::Known(Some(hit)) => Some(hit.distance.to_bits()),
        _ => None,
    }
}

/// Compares the answers of the device about shapes, and returns them.
fn compare_shapes<S: Shape + Question<Answer = bool> + Debug>(
    scene: &Scene,
    name: &str,
    shapes: &[S],
) -> Replies<bool> {
    let replies = ask(scene, shapes);
    for (shape, reply) in shapes.iter().zip(&replies.answers) {
        assert_eq!(*reply, overlaps(scene.pages(), shape).into(), "{name}: {shape:?}");
    }
    replies
}

fn compare(device: &Device, pages: &Pages, count: usize, seed: u64, tally: &mut Tally) {
    let scene = Scene::new(device, &pages.pages).unwrap();
    let (name, pages) = (&pages.name, &pages.pages);
    let mut asker = Asker::new(pages, seed);

    let boxes: Vec<_> = (0..count).map(|_| asker.shape()).collect();
    tally.add(0, &compare_shapes(&scene, name, &boxes), |hit| *hit);
    let cylinders: Vec<_> = (0..count).map(|_| asker.cylinder()).collect();
    tally.add(1, &compare_shapes(&scene, name, &cylinders), |hit| *hit);
    let spheres: Vec<_> = (0..count).map(|_| asker.sphere()).collect();
    tally.add(2, &compare_shapes(&scene, name, &spheres), |hit| *hit);

    let questions: Vec<_> = (0..count).map(|_| asker.below()).collect();
    let replies = ask(&scene, &questions);
    for (below, reply) in questions.iter().zip(&replies.answers) {
        assert_eq!(*reply, floor_under(pages, &below.shape, below.from, below.depth).into(), "{name}: {below:?}");
    }
    tally.add(3, &replies, Option::is_some);

    let rays: Vec<_> = (0..count).map(|_| asker.ray()).collect();
    let replies = ask(&scene, &rays);
    for (ray, reply) in rays.iter().zip(&replies.answers) {
        let expected: Reply<Option<RayHit>> = cast(pages, ray).into();
        assert_eq!(*reply, expected, "{name}: {ray:?}");
        assert_eq!(bits(reply), bits(&expected), "{name}: {ray:?}");
    }
    tally.add(4, &replies, Option::is_some);
}

/// Checks that there were hits, and that the device rather than the processor found the answers; `most` in a hundred of
/// each kind may be the processor's.
fn judge(tally: &Tally, most: [usize; 5]) {
    for ((kind, [all, by_processor, positive]), most) in KINDS.into_iter().zip(tally.0).zip(most) {
        let share = 100.0 * by_processor as f64 / all as f64;
        eprintln!("{kind}: {all} answers, {positive} hits, {by_processor} by the processor ({share:.2} %)");
        assert!(positive * 50 > all && positive < all, "{kind}: {positive} hits of {all}");
        assert!(by_processor * 100 <= all * most, "{kind}: {share:.2} % were left to the processor");
    }
}

#[test]
fn all_answers_about_random_pages_equal_the_processors() {
    let Some(device) = device() else { return };
    let (mut tally, mut tally_of_parts) = (Tally::default(), Tally::default());
    let count = wanted() / 2 / 48 + 1;
    for seed in 0..48 {
        let pages = random_pages(seed, [0.0, 5e5, -1e7][seed as usize % 3]);
        compare(&device, &pages, count, seed, &mut tally);
        compare(&device, &partly_loaded(&pages, seed), count / 4 + 1, seed, &mut tally_of_parts);
    }
    judge(&tally, [8, 8, 8, 8, 30]);
    judge(&tally_of_parts, [8, 8, 8, 8, 60]);
}

#[test]
fn all_answers_about_scans_equal_the_processors() {
    let Some(device) = device() else { return };
    let mut scenes = vec![generated("house", 400_000, 0.05), generated("stairs", 60_000, 0.03)];
    for (name, pixel) in [
        ("indoor_two_storey_zup.laz", 0.05),
        ("pump_room.laz", 0.05),
        ("forest_plot_tls.laz", 0.1),
        ("delft_city_block_ahn3.laz", 0.5),
    ] {
        scenes.extend(data::file(name).map(|path| converted(name, &path, pixel)));
    }
    let count = wanted() / 2 / scenes.len() + 1;
    let mut tally = Tally::default();
    for (seed, pages) in (0..).zip(&scenes) {
        compare(&device, pages, count, seed, &mut tally);
    }
    let parts = scenes.iter().map(|scene| partly_loaded(scene, 7));
    let mut tally_of_parts = Tally::default();
    parts.for_each(|pages| compare(&device, &pages, count / 4 + 1, 7, &mut tally_of_parts));
    judge(&tally, [8, 8, 8, 8, 30]);
    judge(&tally_of_parts, [8, 8, 8, 8, 60]);
}
