//! Batches of queries, ordered by place so that each page enters the processor's caches once.

use super::grid::Shape;
use super::grid::sealed::OnPixels;
use super::{Overlap, overlaps};
use crate::store::Snapshot;

/// Page sets smaller than this (bytes) mostly stay in the processor's caches, where reordering only costs (`bench scale
/// --only queries`).
const IN_CACHE: f64 = (64 << 20) as f64;
/// Shapes sampled to decide whether ordering pays; batches of fewer than four times this number are never ordered.
const SAMPLE: usize = 64;
/// Most cells, per four shapes, of the grid by which shapes are ordered.
const CELLS: u64 = 4;

/// A tile column.
type Tile = [i32; 2];

/// Returns the first pixel under a shape.
pub(super) fn pixel_of<H: Shape>(set: &Snapshot, shape: &H) -> [i64; 2] {
    let rect = shape.on_grid(set.frame()).rect();
    [rect.i0, rect.j0]
}

/// Answers each of `questions` into the element of `answers` with the same number.
///
/// # Panics
/// If there are fewer answers than questions.
pub(super) fn answer_each<Q, A>(
    set: &Snapshot,
    questions: &[Q],
    answers: &mut [A],
    pixel: impl Fn(&Q) -> [i64; 2],
    ask: impl Fn(&Q) -> A,
) {
    assert!(answers.len() >= questions.len(), "{} answers for {} questions", answers.len(), questions.len());
    match order(set, questions, pixel) {
        Some(order) => {
            order
                .into_iter()
                .map(|number| number as usize)
                .for_each(|number| answers[number] = ask(&questions[number]));
        }
        None => questions.iter().zip(answers).for_each(|(question, answer)| *answer = ask(question)),
    }
}

/// Runs [`overlaps`] for each of `shapes` into the element of `answers` with the same number.
///
/// # Panics
/// If there are fewer answers than shapes.
pub(super) fn overlaps_each<H: Shape>(set: &Snapshot, shapes: &[H], answers: &mut [Overlap]) {
    assert!(answers.len() >= shapes.len(), "{} answers for {} shapes", answers.len(), shapes.len());
    let Some(order) = order(set, shapes, |shape| pixel_of(set, shape)) else {
        return shapes.iter().zip(answers).for_each(|(shape, answer)| *answer = overlaps(set, shape));
    };
    // An answer takes 200 bytes, too many for scattered writes: store its kind and ask again if pages are missing.
    let mut kinds = vec![0u8; shapes.len()];
    for number in order {
        kinds[number as usize] = match overlaps(set, &shapes[number as usize]) {
            Overlap::Clear => 0,
            Overlap::Hit => 1,
            Overlap::NotLoaded(_) => 2,
        };
    }
    for ((shape, answer), kind) in shapes.iter().zip(answers).zip(kinds) {
        *answer = match kind {
            0 => Overlap::Clear,
            1 => Overlap::Hit,
            _ => overlaps(set, shape),
        };
    }
}

/// Returns the numbers of `questions` ordered by place: those that begin in the same cell of a grid over all of them
/// become neighbours. `None` if their own order is as good: few questions, few pages under them, or neighbours already
/// close together.
///
/// Memory: 12 bytes a question, and up to 4 for the cells. Cost: about two looks at each question.
fn order<Q>(set: &Snapshot, questions: &[Q], pixel: impl Fn(&Q) -> [i64; 2]) -> Option<Vec<u32>> {
    let bounds = set.bounds()?;
    let count = u32::try_from(questions.len()).ok().filter(|&count| count as usize >= 4 * SAMPLE)?;
    let tile = |question: &Q| -> Tile {
        let [i, j] = pixel(question);
        [(i, 0), (j, 1)]
            .map(|(first, axis)| (first >> 6).clamp(bounds.min[axis].into(), bounds.max[axis].into()) as i32)
    };
    if !pays(set, questions, tile) {
        return None;
    }
    let tiles: Vec<Tile> = questions.iter().map(tile).collect();
    let [min, max] = extent(tiles.iter().copied());
    // Use the smallest cells of which there are at most `CELLS` per four shapes.
    let size = |axis: usize, shift: u32| u64::from(max[axis].abs_diff(min[axis]) >> shift) + 1;
    let shift = (0..).find(|&shift| size(0, shift) * size(1, shift) <= u64::from(count) / 4 * CELLS).unwrap_or(31);
    let width = size(0, shift) as usize;
    let cell = |[x, y]: &Tile| (y.abs_diff(min[1]) >> shift) as usize * width + (x.abs_diff(min[0]) >> shift) as usize;
    // Counting sort.
    let mut places = vec![0u32; width * size(1, shift) as usize];
    tiles.iter().for_each(|tile| places[cell(tile)] += 1);
    let mut sum = 0;
    for place in &mut places {
        sum += std::mem::replace(place, sum);
    }
    let mut order = vec![0; questions.len()];
    for (tile, number) in tiles.iter().zip(0..count) {
        let place = &mut places[cell(tile)];
        order[*place as usize] = number;
        *place += 1;
    }
    Some(order)
}

/// Returns the least and the greatest of both indices.
fn extent(tiles: impl Iterator<Item = Tile>) -> [Tile; 2] {
    tiles.fold([[i32::MAX; 2], [i32::MIN; 2]], |[min, max], [x, y]| {
        [[min[0].min(x), min[1].min(y)], [max[0].max(x), max[1].max(y)]]
    })
}

/// Returns whether the pages under a sample of the questions exceed a cache while successive questions lie apart.
fn pays<Q>(set: &Snapshot, questions: &[Q], tile: impl Fn(&Q) -> Tile) -> bool {
    let weight = set.weight_bytes() as f64;
    if weight <= IN_CACHE {
        return false;
    }
    let step = questions.len() / SAMPLE;
    let pairs = || (0..SAMPLE).map(|n| [&questions[n * step], &questions[n * step + 1]].map(&tile));
    let [min, max] = extent(pairs().map(|pair| pair[0]));
    let under = (f64::from(max[0]) - f64::from(min[0]) + 1.0) * (f64::from(max[1]) - f64::from(min[1]) + 1.0);
    let apart = pairs().filter(|[a, b]| a[0].abs_diff(b[0]).max(a[1].abs_diff(b[1])) > 1).count();
    weight * (under / set.column_count() as f64).min(1.0) > IN_CACHE && apart > SAMPLE / 4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Frame, PageKey};
    use crate::page::{Page, PageBuilder, Span};
    use crate::query::*;
    use crate::store::Snapshot;
    use nalgebra::{Point3, Vector3};
    use std::panic::{AssertUnwindSafe, catch_unwind};

    /// `edge` × `edge` pages of about 50 kB.
    fn store(edge: i32) -> Snapshot {
        store_of((0..edge * edge).map(|n| [n % edge - edge / 2, n / edge - edge / 2]))
    }

    fn store_of(tiles: impl Iterator<Item = Tile>) -> Snapshot {
        let mut builder = PageBuilder::default();
        for at in 0..64 * 64 {
            let spans = [(100, 120 + at % 50), (400, 500 + at % 90), (2000, 2100)];
            assert!(builder.set_column(
                at % 64,
                at / 64,
                &spans.map(|(low, high)| Span::new(low, high, false).unwrap())
            ));
        }
        let page: Page = builder.build();
        let keys = tiles.map(|[tx, ty]| PageKey { tx, ty, layer: 0 });
        Snapshot::from_pages(Frame::new(0.1, 0.3).unwrap(), keys.map(|key| (key, page.clone())))
    }

    /// Boxes across the pages of [`store`] and around them; successive boxes lie far apart.
    fn boxes(count: usize, edge: i32) -> Vec<Aabb> {
        let side = f64::from(edge) * 6.4 + 2.0;
        let place = |n: usize, step: f64| (n as f64 * step).fract() * side - side / 2.0;
        let standing = |n| {
            let at = [place(n, 0.618_033_9), place(n, 0.324_717_9), 0.01 * (n % 100) as f64];
            Aabb::standing(at.into(), Vector3::new(0.05, 0.05, 0.02)).unwrap()
        };
        (0..count).map(standing).collect()
    }

    #[test]
    fn boxes_are_ordered_by_place_where_pages_are_many_and_get_the_same_answers() {
        let (store, boxes) = (store(40), boxes(3000, 40));
        let order = order(&store, &boxes, |shape| pixel_of(&store, shape)).unwrap();
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.iter().copied().eq(0..3000), "each once");
        let tile = |number: u32| pixel_of(&store, &boxes[number as usize]).map(|first| first >> 6);
        let changes = order.windows(2).filter(|pair| tile(pair[0]) != tile(pair[1])).count();
        assert!(changes < 1700, "{changes} changes of the tile, of which about 1350 have a box");
        let mut answers = vec![Overlap::Clear; boxes.len()];
        overlaps_each(&store, &boxes, &mut answers);
        assert!(boxes.iter().zip(&answers).all(|(shape, answer)| *answer == overlaps(&store, shape)));
        assert!((500..2500).contains(&answers.iter().filter(|answer| **answer == Overlap::Hit).count()));
        let mut again = vec![Overlap::Clear; boxes.len()];
        answer_each(&store, &boxes, &mut again, |shape| pixel_of(&store, shape), |shape| overlaps(&store, shape));
        assert_eq!(again, answers);
    }

    #[test]
    fn the_cells_of_an_order_are_the_smallest_that_are_no_more_than_the_questions() {
        let store = store(40);
        // 1600 tiles: cells of one tile for 3000 questions, of 2 × 2 tiles for 1000.
        for (count, edge) in [(3000u32, 1), (1000, 2)] {
            let boxes = boxes(count as usize, 40);
            let cell = |number: &u32| {
                let [i, j] = pixel_of(&store, &boxes[*number as usize]);
                [j, i].map(|first| (first.div_euclid(64).clamp(-20, 19) + 20) / edge)
            };
            let mut expected: Vec<u32> = (0..count).collect();
            expected.sort_by_key(cell);
            assert_eq!(order(&store, &boxes, |shape| pixel_of(&store, shape)), Some(expected), "{count} questions");
        }
    }

    #[test]
    fn boxes_along_a_passage_of_one_tile_are_ordered() {
        for axis in [0, 1] {
            let store = store_of((0..1600).map(|n| if axis == 0 { [n, 0] } else { [0, n] }));
            let standing = |n: usize| {
                let mut at = [3.0; 3];
                at[axis] = (n as f64 * 0.618_033_9).fract() * 1600.0 * 6.4;
                Aabb::standing(at.into(), Vector3::new(0.05, 0.05, 0.02)).unwrap()
            };
            let boxes: Vec<Aabb> = (0..3000).map(standing).collect();
            let order = order(&store, &boxes, |shape| pixel_of(&store, shape)).unwrap();
            let tiles = order.iter().map(|&number| pixel_of(&store, &boxes[number as usize])[axis].max(0) >> 6);
            assert!(tiles.is_sorted(), "along axis {axis}");
        }
    }

    #[test]
    fn ordered_boxes_name_the_pages_that_each_of_them_misses() {
        let (store, boxes) = (store(40).keep_loaded(|key| key.tx != 0), boxes(3000, 40));
        assert!(order(&store, &boxes, |shape| pixel_of(&store, shape)).is_some());
        let mut answers = vec![Overlap::Clear; boxes.len()];
        overlaps_each(&store, &boxes, &mut answers);
        assert!(boxes.iter().zip(&answers).all(|(shape, answer)| *answer == overlaps(&store, shape)));
        let waiting = answers.iter().filter(|answer| matches!(answer, Overlap::NotLoaded(_))).count();
        assert!(waiting > 20, "{waiting} boxes wait");
    }

    /// Checks that a batch answers each question like `single`, and panics if it has room for one answer too few.
    fn check<Q, A: Clone + PartialEq>(
        questions: &[Q],
        none: A,
        batch: impl Fn(&[Q], &mut [A]),
        single: impl Fn(&Q) -> A,
    ) {
        let mut answers = vec![none.clone(); questions.len()];
        batch(questions, &mut answers);
        assert!(questions.iter().zip(&answers).all(|(question, answer)| *answer == single(question)));
        // An answer left as it was would be `none`.
        assert!(answers.iter().filter(|answer| **answer != none).count() > 20);
        let panic = catch_unwind(AssertUnwindSafe(|| batch(questions, &mut answers[1..]))).unwrap_err();
        let message = panic.downcast::<String>().unwrap();
        assert!(message.contains("999 answers for 1000"), "{message}");
    }

    #[test]
    fn ordered_batches_answer_like_single_queries_and_need_room_for_each_answer() {
        let (store, boxes) = (store(40), boxes(1000, 40));
        assert!(order(&store, &boxes, |shape| pixel_of(&store, shape)).is_some());
        let places: Vec<Point3<f64>> = boxes.iter().map(Aabb::min).collect();
        let ray = |place: &Point3<f64>| Ray::new(*place, Vector3::new(1.0, 0.5, 0.1), 3.0).unwrap();
        let rays: Vec<Ray> = places.iter().map(ray).collect();
        let ways: Vec<(Aabb, Vector3<f64>)> =
            boxes.iter().map(|shape| (*shape, Vector3::new(0.3, -0.2, 0.1))).collect();
        let max = 0.1;
        check(&boxes, Overlap::Clear, |of, into| overlaps_batch(&store, of, into), |shape| overlaps(&store, shape));
        let nothing = Answer::Known(Probe::default());
        check(&boxes, nothing, |of, into| probe_batch(&store, of, into), |shape| probe(&store, shape));
        check(&rays, Answer::Known(None), |of, into| cast_batch(&store, of, into), |ray| cast(&store, ray));
        check(
            &ways,
            Answer::Known(None),
            |of, into| sweep_batch(&store, of, into),
            |(shape, motion)| sweep(&store, shape, *motion),
        );
        check(
            &boxes,
            Answer::Known(None),
            |of, into| clearance_batch(&store, of, max, into),
            |shape| clearance(&store, shape, max),
        );
        check(
            &boxes,
            Answer::Known(None),
            |of, into| depenetrate_batch(&store, of, max, into),
            |shape| depenetrate(&store, shape, max),
        );
        check(
            &places,
            Answer::Known(None),
            |of, into| nearest_surface_batch(&store, of, max, into),
            |place| nearest_surface(&store, *place, max),
        );
    }

    #[test]
    fn what_is_small_few_near_or_in_order_already_is_left_alone() {
        let large = store(40);
        let none = |store: &Snapshot, boxes: &[Aabb]| order(store, boxes, |shape| pixel_of(store, shape)).is_none();
        assert!(none(&store(4), &boxes(3000, 4)), "small");
        assert!(none(&large, &boxes(100, 40)), "few");
        assert!(none(&large, &boxes(3000, 3)), "near each other");
        let pairs: Vec<Aabb> = boxes(1500, 40).into_iter().flat_map(|shape| [shape; 2]).collect();
        assert!(none(&large, &pairs), "in pairs");
        let mut sorted = boxes(3000, 40);
        sorted.sort_by_key(|shape| pixel_of(&large, shape).map(|first| first >> 6));
        assert!(none(&large, &sorted), "in order");
        assert!(none(&store(0), &boxes(3000, 40)), "no pages");
    }
}
