//! Seeded scan generator.
