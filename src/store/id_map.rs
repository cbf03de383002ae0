//! A small map from ascending ids. Less code than a tree, which would be compiled again for each type of value.

/// Pairs in ascending order of their ids. Appending and lookups are cheap; removal moves all later pairs.
#[derive(Debug)]
pub(super) struct IdMap<K, V>(Vec<(K, V)>);

impl<K: Ord + Copy, V> IdMap<K, V> {
    pub const fn new() -> Self {
        Self(Vec::new())
    }

    fn place(&self, id: &K) -> Result<usize, usize> {
        self.0.binary_search_by(|(other, _)| other.cmp(id))
    }

    /// Inserts a value and drops the previous one of the same id.
    pub fn insert(&mut self, id: K, thing: V) {
        match self.place(&id) {
            Ok(at) => self.0[at].1 = thing,
            Err(at) => self.0.insert(at, (id, thing)),
        }
    }

    pub fn get(&self, id: &K) -> Option<&V> {
        self.place(id).ok().map(|at| &self.0[at].1)
    }

    pub fn get_mut(&mut self, id: &K) -> Option<&mut V> {
        self.place(id).ok().map(|at| &mut self.0[at].1)
    }

    pub fn remove(&mut self, id: &K) -> Option<V> {
        self.place(id).ok().map(|at| self.0.remove(at).1)
    }

    pub fn iter(&self) -> impl Iterator<Item = &(K, V)> {
        self.0.iter()
    }

    pub fn ids(&self) -> Vec<K> {
        self.0.iter().map(|(id, _)| *id).collect()
    }

    pub fn values(&self) -> impl Iterator<Item = &V> {
        self.0.iter().map(|(_, thing)| thing)
    }

    pub fn values_mut(&mut self) -> impl Iterator<Item = &mut V> {
        self.0.iter_mut().map(|(_, thing)| thing)
    }

    pub fn into_values(self) -> impl Iterator<Item = V> {
        self.0.into_iter().map(|(_, thing)| thing)
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn behaves_as_a_tree(steps in proptest::collection::vec((0u8..3, 0u64..12, any::<u16>()), 0..60)) {
            let (mut found, mut expected) = (IdMap::new(), BTreeMap::new());
            for (kind, id, thing) in steps {
                match kind {
                    0 => {
                        found.insert(id, thing);
                        expected.insert(id, thing);
                    }
                    1 => prop_assert_eq!(found.remove(&id), expected.remove(&id)),
                    _ => prop_assert_eq!(found.get_mut(&id).copied(), expected.get(&id).copied()),
                }
                prop_assert_eq!(found.is_empty(), expected.is_empty());
                prop_assert!(found.iter().map(|(id, thing)| (id, thing)).eq(&expected));
            }
            prop_assert!(found.into_values().eq(expected.into_values()));
        }
    }
}
