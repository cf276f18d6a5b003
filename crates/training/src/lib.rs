//! Trains the quality model that ships with the program, on pictures that the project makes itself, and measures how it
//! ranks. The pictures, labels and models are reproducible from a seed.

pub mod agreement;
pub mod distort;
pub mod evaluate;
pub mod examples;
pub mod field;
pub mod labels;
pub mod measures;
pub mod random;
pub mod report;
pub mod scenes;
pub mod store;
pub mod svm;
pub mod targets;
pub mod training;
