//! Byte budget that is never exceeded: callers reserve before they allocate; dropping the reservation releases it.

use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;

/// Bytes in use under a budget.
#[derive(Debug)]
pub(super) struct Account {
    budget: usize,
    used: AtomicUsize,
    peak: AtomicUsize,
}

impl Account {
    pub fn new(budget: usize) -> Arc<Self> {
        Arc::new(Self { budget, used: AtomicUsize::new(0), peak: AtomicUsize::new(0) })
    }

    /// Reserves `bytes` if the budget allows.
    pub fn take(self: &Arc<Self>, bytes: usize) -> Option<Room> {
        // Relaxed: nothing but the counters depends on their order.
        let add = |used: usize| used.checked_add(bytes).filter(|&sum| sum <= self.budget);
        let before = self.used.fetch_update(Relaxed, Relaxed, add).ok()?;
        self.peak.fetch_max(before + bytes, Relaxed);
        Some(Room { account: self.clone(), bytes })
    }

    /// Reserves all that is left of the budget.
    #[cfg(test)]
    pub fn take_rest(self: &Arc<Self>) -> Room {
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

/// Reservation of bytes in an [`Account`], released when dropped.
#[derive(Debug)]
pub(super) struct Room {
    account: Arc<Account>,
    bytes: usize,
}

impl Room {
    /// Splits `bytes` off this reservation, or all of it if it is smaller.
    pub fn split(&mut self, bytes: usize) -> Self {
        let bytes = bytes.min(self.bytes);
        self.bytes -= bytes;
        Self { account: self.account.clone(), bytes }
    }

    pub fn bytes(&self) -> usize {
        self.bytes
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        self.account.used.fetch_sub(self.bytes, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_given_back_and_never_exceeds_the_budget() {
        let account = Account::new(100);
        let mut first = account.take(60).unwrap();
        assert!(account.take(41).is_none());
        assert!(account.take(usize::MAX).is_none());
        let part = first.split(20);
        assert_eq!((first.bytes(), part.bytes(), account.used()), (40, 20, 60));
        drop(first);
        let second = account.take(80).unwrap();
        assert_eq!(account.used(), 100);
        drop((part, second));
        assert_eq!((account.used(), account.peak(), account.budget()), (0, 100, 100));
    }
}
