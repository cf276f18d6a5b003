//! What can go wrong with a recording.

/// What can go wrong while a recording is written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The disk, or whatever stands for it.
    #[error("{action} the recording failed: {source}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
    /// Not a recording, or one that this program does not read.
    #[error("{0}")]
    Format(String),
    /// A record that contradicts the file it stands in.
    #[error("the recording is damaged at byte {offset}: {reason}")]
    Damaged {
        /// Where the record begins.
        offset: u64,
        /// What is wrong.
        reason: String,
    },
    /// A message whose content does not fit its schema.
    #[error("a message of the recording cannot be read: {0}")]
    Message(String),
    /// A picture.
    #[error("a picture cannot be {action}: {reason}")]
    Picture {
        /// encoded, decoded.
        action: &'static str,
        /// Why.
        reason: String,
    },
    /// A recording that is whole but lacks what a replay needs.
    #[error("the recording cannot be replayed: {0}")]
    Replay(String),
    /// A setting outside its range.
    #[error("the setting {name} is {value}; {right}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it is.
        value: String,
        /// What would be right.
        right: &'static str,
    },
}
