//! Bugs that are planted to show that the watcher catches them.

/// A bug of the test's own, never in the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bug {
    /// Orders to hold move the axes on by a degree.
    HoldIgnored,
    /// A fault is cleared without a person's word.
    ClearsItself,
    /// A chunk of the recording is not written.
    ChunkLost,
}

impl Bug {
    /// By its name on the command line.
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "hold-ignored" => Some(Bug::HoldIgnored),
            "clears-itself" => Some(Bug::ClearsItself),
            "chunk-lost" => Some(Bug::ChunkLost),
            _ => None,
        }
    }
}
