//! The twin's world: a walking person in a room, rendered exactly, with ground truth.
