//! What waits to be written: numbers, which are never thinned, and pictures, which are.
//!
//! Both have a bound. Numbers of a step are a few kilobytes, so that their bound is minutes away; pictures of a pair are megabytes, and their
//! bound is what a slow disk reaches first.

use std::collections::VecDeque;

use vergence_imaging::Rgb;

/// Bounds of the queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most bytes of pictures that wait, uncompressed; at least one pair is taken.
    pub pictures_bytes: usize,
    /// Most bytes of numbers that wait; those of at least one step are taken.
    pub numbers_bytes: usize,
}

impl Default for Limits {
    /// Twelve pairs of 1024x768; numbers of some five minutes.
    fn default() -> Self {
        Self {
            pictures_bytes: 56 << 20,
            numbers_bytes: 48 << 20,
        }
    }
}

/// How the storage behind the queue stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outlet {
    /// It takes what comes, however slowly.
    Open,
    /// It failed, and all the room is needed for numbers.
    Failed,
}

/// Thinning goes up to one pair in this many.
const THINNEST: u64 = 64;

/// Pairs that must find the queue nearly empty before more of them are kept again: two seconds at 30 a second.
const CALM_PAIRS: u32 = 60;

/// A message on its way into a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Item {
    /// Index of its channel.
    pub channel: usize,
    /// When what it speaks of was so, ns.
    pub publish_ns: u64,
    /// Its content.
    pub data: Vec<u8>,
}

/// The pictures of one pair on their way into a file.
pub struct PicturePair {
    /// Left and right.
    pub pictures: [Rgb; 2],
    /// Middle of their exposures, ns.
    pub capture_ns: [u64; 2],
}

/// What is written in one go.
pub enum Work {
    /// Messages of one time.
    Numbers {
        /// When they were recorded, ns.
        log_ns: u64,
        /// The messages.
        items: Vec<Item>,
    },
    /// Pictures of one pair.
    Pictures {
        /// When they were recorded, ns.
        log_ns: u64,
        /// The pictures.
        pair: PicturePair,
    },
}

/// What happened to what was offered, so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Pairs whose pictures were taken into the queue.
    pub pictures_kept: u64,
    /// Pairs whose pictures were left out.
    pub pictures_thinned: u64,
    /// Messages taken into the queue.
    pub numbers_kept: u64,
    /// Messages lost since even the numbers' bound was reached.
    pub numbers_lost: u64,
}

/// The queue.
pub struct Queue {
    limits: Limits,
    waiting: VecDeque<Work>,
    pictures_bytes: usize,
    numbers_bytes: usize,
    every: u64,
    offered: u64,
    calm: u32,
    /// Pairs of pictures that wait, and how many of them have waited since before it was thinned last.
    pairs: usize,
    older: usize,
    counts: Counts,
    spare: Vec<Rgb>,
}

impl Queue {
    /// An empty queue.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            waiting: VecDeque::new(),
            pictures_bytes: 0,
            numbers_bytes: 0,
            every: 1,
            offered: 0,
            calm: 0,
            pairs: 0,
            older: 0,
            counts: Counts::default(),
            spare: Vec::new(),
        }
    }

    /// What happened so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// One pair in how many keeps its pictures now.
    pub fn every(&self) -> u64 {
        self.every
    }

    /// Bytes that wait: pictures, numbers.
    pub fn bytes(&self) -> [usize; 2] {
        [self.pictures_bytes, self.numbers_bytes]
    }

    /// Whether the pictures of a pair of so many bytes fit now without thinning.
    pub fn has_room(&self, bytes: usize) -> bool {
        self.pictures_bytes == 0
            || self.pictures_bytes.saturating_add(bytes) <= self.limits.pictures_bytes
    }

    /// Whether these messages fit.
    pub fn has_room_for(&self, items: &[Item]) -> bool {
        self.numbers_bytes == 0
            || self.numbers_bytes.saturating_add(size_of_items(items)) <= self.limits.numbers_bytes
    }

    /// Decide about the pictures of the next pair (of so many bytes), and count it. When the queue is full fewer pairs are kept from then on, evenly;
    /// when it has been nearly empty for a while, more again. A storage that failed gets no pictures, which says nothing of how fast it is.
    pub fn wants_pictures(&mut self, bytes: usize, outlet: Outlet) -> bool {
        if outlet == Outlet::Failed {
            self.offered += 1;
            self.counts.pictures_thinned += 1;
            return false;
        }
        let full = !self.has_room(bytes);
        if full {
            // Twice as thin at once, but not again before the pairs on the way are through: then it was not enough.
            if self.older == 0 {
                self.every = (self.every * 2).min(THINNEST);
                self.older = self.pairs;
            }
            self.calm = 0;
        } else if self.pictures_bytes <= self.limits.pictures_bytes / 4 {
            self.calm += 1;
            if self.calm >= CALM_PAIRS && self.every > 1 {
                self.every /= 2;
                self.calm = 1;
            }
        }
        let wanted = !full && self.offered.is_multiple_of(self.every);
        self.offered += 1;
        match wanted {
            true => self.counts.pictures_kept += 1,
            false => self.counts.pictures_thinned += 1,
        }
        wanted
    }

    /// Put pictures in; they are copied into buffers that were used before.
    pub fn push_pictures(&mut self, log_ns: u64, pictures: [&Rgb; 2], capture_ns: [u64; 2]) {
        let copies = pictures.map(|picture| self.copy(picture));
        self.pictures_bytes += bytes_of(&copies);
        self.pairs += 1;
        self.waiting.push_back(Work::Pictures {
            log_ns,
            pair: PicturePair {
                pictures: copies,
                capture_ns,
            },
        });
    }

    /// Put numbers in; what does not fit is lost and counted.
    pub fn push_numbers(&mut self, log_ns: u64, items: Vec<Item>) {
        if !self.has_room_for(&items) {
            self.counts.numbers_lost += items.len() as u64;
            return;
        }
        self.counts.numbers_kept += items.len() as u64;
        self.numbers_bytes += size_of_items(&items);
        self.waiting.push_back(Work::Numbers { log_ns, items });
    }

    /// The next to be written.
    pub fn pop(&mut self) -> Option<Work> {
        let work = self.waiting.pop_front()?;
        match &work {
            Work::Numbers { items, .. } => self.numbers_bytes -= size_of_items(items),
            Work::Pictures { pair, .. } => {
                self.pictures_bytes -= bytes_of(&pair.pictures);
                self.pairs -= 1;
                self.older = self.older.saturating_sub(1);
            }
        }
        Some(work)
    }

    /// Take out every picture that waits: the disk takes nothing, and numbers need the room.
    pub fn drop_pictures(&mut self) {
        let mut kept = VecDeque::with_capacity(self.waiting.len());
        for work in std::mem::take(&mut self.waiting) {
            match work {
                Work::Pictures { pair, .. } => {
                    self.counts.pictures_kept -= 1;
                    self.counts.pictures_thinned += 1;
                    self.give_back(pair);
                }
                Work::Numbers { .. } => kept.push_back(work),
            }
        }
        self.waiting = kept;
        self.pictures_bytes = 0;
        (self.pairs, self.older) = (0, 0);
    }

    /// Nothing more is written: what waits is lost, and counted as such.
    pub fn give_up(&mut self) {
        self.drop_pictures();
        for work in std::mem::take(&mut self.waiting) {
            if let Work::Numbers { items, .. } = work {
                self.counts.numbers_kept -= items.len() as u64;
                self.counts.numbers_lost += items.len() as u64;
            }
        }
        self.numbers_bytes = 0;
    }

    /// Buffers of pictures that were written, to be used again.
    pub fn give_back(&mut self, pair: PicturePair) {
        if self.spare.len() < 8 {
            self.spare.extend(pair.pictures);
        }
    }

    fn copy(&mut self, picture: &Rgb) -> Rgb {
        match self.spare.pop().filter(|s| s.size() == picture.size()) {
            Some(mut spare) => {
                spare.samples_mut().copy_from_slice(picture.samples());
                spare
            }
            None => picture.clone(),
        }
    }
}

/// Bytes of the pictures of a pair.
fn bytes_of(pictures: &[Rgb; 2]) -> usize {
    pictures.iter().map(|p| 3 * p.samples().len()).sum()
}

/// What messages take in memory, with what holds them.
fn size_of_items(items: &[Item]) -> usize {
    items
        .iter()
        .map(|item| item.data.len() + size_of::<Item>())
        .sum()
}

#[cfg(test)]
mod tests {
    //! Proves: sizes that no memory has do not overflow a bound; a storage that failed takes no pictures and does not thin those that come later; what is
    //! given up is counted as lost; a disk that takes one pair in six gets no more than it can take, evenly, and all again once it is fast.
    use super::*;

    fn item(bytes: usize) -> Item {
        Item {
            channel: 0,
            publish_ns: 0,
            data: vec![0; bytes],
        }
    }

    #[test]
    fn sizes_without_end() {
        let mut queue = Queue::new(Limits::default());
        let picture = Rgb::from_fn(4, 4, |_, _| [0; 3]);
        queue.push_pictures(0, [&picture, &picture], [0; 2]);
        assert!(!queue.wants_pictures(usize::MAX, Outlet::Open));
        assert_eq!(queue.every(), 2);
    }

    #[test]
    fn a_failed_storage_says_nothing_of_its_speed() {
        let mut queue = Queue::new(Limits::default());
        for _ in 0..500 {
            assert!(!queue.wants_pictures(1000, Outlet::Failed));
        }
        assert_eq!((queue.every(), queue.counts().pictures_thinned), (1, 500));
        assert!(queue.wants_pictures(1000, Outlet::Open));
    }

    #[test]
    fn a_slow_disk_gets_what_it_can_take() {
        let picture = Rgb::from_fn(4, 4, |_, _| [0; 3]);
        let bytes = bytes_of(&[picture.clone(), picture.clone()]);
        let mut queue = Queue::new(Limits {
            pictures_bytes: 12 * bytes,
            ..Limits::default()
        });
        let offer = |queue: &mut Queue, n: u64, takes_every: u64| {
            let wanted = queue.wants_pictures(bytes, Outlet::Open);
            if wanted {
                queue.push_pictures(n, [&picture, &picture], [0; 2]);
            }
            if n.is_multiple_of(takes_every) {
                queue.pop();
            }
            wanted
        };
        // A minute at 30 pairs a second.
        let kept: Vec<u64> = (0..1800).filter(|n| offer(&mut queue, *n, 6)).collect();
        let late: Vec<u64> = (kept.iter().copied()).filter(|n| *n >= 900).collect();
        assert!((8..=16).contains(&queue.every()), "{}", queue.every());
        let gaps = late.windows(2).map(|pair| pair[1] - pair[0]);
        let widest = gaps.max().unwrap();
        assert!(widest <= 16, "{widest}");
        assert!(late.len() > 900 / 16, "{}", late.len());
        for n in 1800..3600 {
            offer(&mut queue, n, 1);
        }
        assert_eq!(queue.every(), 1);
    }

    #[test]
    fn what_is_given_up_is_lost() {
        let mut queue = Queue::new(Limits {
            numbers_bytes: 1000,
            ..Limits::default()
        });
        // The first is taken however large it is: otherwise nothing ever would be.
        queue.push_numbers(0, vec![item(5000), item(0)]);
        queue.push_numbers(0, vec![item(1)]);
        assert_eq!(
            (queue.counts().numbers_kept, queue.counts().numbers_lost),
            (2, 1)
        );
        queue.give_up();
        assert_eq!(
            (queue.counts().numbers_kept, queue.counts().numbers_lost),
            (0, 3)
        );
        assert_eq!(queue.bytes(), [0, 0]);
        assert!(queue.pop().is_none());
    }
}
