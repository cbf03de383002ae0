//! Sorting whose code is small in the browser.
//!
//! The standard library's sort takes some kilobytes of code for each type and order, which adds up to a tenth of the
//! viewer's engine. On WebAssembly these functions are a heap sort. Everywhere, the order of items that compare equal is
//! not defined: give orders in which such items are alike, so that results are the same on every platform.

use std::cmp::Ordering;

/// Sorts by the items' own order. O(n log n), without allocation.
pub fn sort<T: Ord>(items: &mut [T]) {
    sort_by(items, T::cmp);
}

/// Sorts by the order of a key. O(n log n), without allocation.
pub fn sort_by_key<T, K: Ord>(items: &mut [T], mut key: impl FnMut(&T) -> K) {
    sort_by(items, |a, b| key(a).cmp(&key(b)));
}

/// Sorts by an order. O(n log n), without allocation.
pub fn sort_by<T>(items: &mut [T], mut order: impl FnMut(&T, &T) -> Ordering) {
    if cfg!(target_family = "wasm") {
        heap_sort(items, |a, b| order(a, b).is_lt());
    } else {
        items.sort_unstable_by(order);
    }
}

/// Sorts with a heap whose greatest item is the first one (Williams 1964).
fn heap_sort<T>(items: &mut [T], mut is_less: impl FnMut(&T, &T) -> bool) {
    let count = items.len();
    // First the items from the middle on down find their places in the heap; then the greatest one leaves it each time.
    for step in (0..count + count / 2).rev() {
        let (mut at, end) = if step >= count { (step - count, count) } else { (0, step) };
        if step < count {
            items.swap(0, step);
        }
        while let Some(left) = Some(2 * at + 1).filter(|left| *left < end) {
            let right = left + 1;
            let child = if right < end && is_less(&items[left], &items[right]) { right } else { left };
            if !is_less(&items[at], &items[child]) {
                break;
            }
            items.swap(at, child);
            at = child;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_heap_sorts_as_the_standard_library_does(mut items in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut expected = items.clone();
            expected.sort_unstable();
            heap_sort(&mut items, |a, b| a < b);
            prop_assert_eq!(items, expected);
        }
    }
}
