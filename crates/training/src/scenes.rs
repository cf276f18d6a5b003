//! Pristine pictures of our own making: dead leaves of many kinds, and the twin's rooms.

pub mod leaves;
pub mod rooms;
mod texture;

use anyhow::Result;
use vergence_imaging::Gray;

use crate::random::Random;

/// Of how many scenes one is a room of the twin.
const ROOM_EVERY: usize = 5;

/// Scene number `index` of a seed.
pub fn scene(seed: u64, index: usize) -> Result<Gray> {
    let mut random = Random::new(seed, index as u64);
    if index % ROOM_EVERY == ROOM_EVERY - 1 {
        rooms::picture(&mut random)
    } else {
        Ok(leaves::picture(&mut random))
    }
}
