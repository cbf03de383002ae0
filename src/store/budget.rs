//! Byte budget that is never exceeded: callers reserve before they allocate; dropping the reservation releases it.

use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;

/// Bytes in use under a budget.
#[derive(Debug)]
pub(super) struct Budget {
    budget: usize,
    used: AtomicUsize,
    peak: AtomicUsize,
}

impl Budget {
    pub fn new(budget: usize) -> Arc<Self> {
        Arc::new(Self { budget, used: AtomicUsize::new(0), peak: AtomicUsize::new(0) })
    }

    /// Reserves `bytes` if the budget allows.
    pub fn take(self: &Arc<Self>, bytes: usize) -> Option<Reservation> {
        // Relaxed: nothing but the counters depends on their order.
        let add = |used: usize| used.checked_add(bytes).filter(|&sum| sum <= self.budget);
        let before = self.used.fetch_update(Relaxed, Relaxed, add).ok()?;
        self.peak.fetch_max(before + bytes, Relaxed);
        Some(Reservation { budget: self.clone(), bytes })
    }

    /// Reserves all that is left of the budget.
    #[cfg(test)]
    pub fn take_rest(self: &Arc<Self>) -> Reservation {
        self.take(self.budget - self.used()).expect("nobody else takes")
    }

    pub fn budget(&self) -> usize {
        self.budget
    }

    pub fn used(&self) -> usize {
        self.used.load(Relaxed)
    }

    pub fn peak(&self) -> usize {
        self.peak.load(Relaxed)
    }
}

/// Reservation of bytes in a [`Budget`], released when dropped.
#[derive(Debug)]
pub(super) struct Reservation {
    budget: Arc<Budget>,
    bytes: usize,
}

impl Reservation {
    /// Splits `bytes` off this reservation, or all of it if it is smaller.
    pub fn split(&mut self, bytes: usize) -> Self {
        let bytes = bytes.min(self.bytes);
        self.bytes -= bytes;
        Self { budget: self.budget.clone(), bytes }
    }

    /// Adds another reservation of the same budget.
    pub fn join(&mut self, mut other: Self) {
        self.bytes += std::mem::take(&mut other.bytes);
    }

    pub fn bytes(&self) -> usize {
        self.bytes
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.budget.used.fetch_sub(self.bytes, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_given_back_and_never_exceeds_the_budget() {
        let budget = Budget::new(100);
        let mut first = budget.take(60).unwrap();
        assert!(budget.take(41).is_none());
        assert!(budget.take(usize::MAX).is_none());
        let part = first.split(20);
        assert_eq!((first.bytes(), part.bytes(), budget.used()), (40, 20, 60));
        drop(first);
        let mut second = budget.take(70).unwrap();
        second.join(budget.take(10).unwrap());
        assert_eq!((second.bytes(), budget.used()), (80, 100));
        drop((part, second));
        assert_eq!((budget.used(), budget.peak(), budget.budget()), (0, 100, 100));
    }
}
