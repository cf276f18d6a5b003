//! Memory that serves one picture after the other: a plane of a megapixel is two thousand pages, and asking the system for
//! them anew costs a good part of a Fourier transform of it.

use std::sync::{Mutex, PoisonError};

use vergence_fft::Complex64;
use vergence_imaging::Plane;

use super::pyramid::Masks;

/// Memory of workspaces that is kept between pictures; what is larger goes back to the system.
const KEPT_BYTES: usize = 2 << 30;

static KEPT: Mutex<Vec<Workspace>> = Mutex::new(Vec::new());

/// Buffers for the planes and spectra of one picture, and what the last one's size asked for.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    pub(crate) masks: Option<Masks>,
    planes: Shelf<f64>,
    spectra: Shelf<Complex64>,
}

impl Workspace {
    /// One that served before, or a new one.
    pub(crate) fn kept() -> Self {
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        kept.pop().unwrap_or_default()
    }

    /// Keep the buffers that this picture used for the next one, as long as that is little memory.
    pub(crate) fn keep(mut self) {
        self.planes.forget_unused();
        self.spectra.forget_unused();
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes: usize = kept.iter().map(Self::bytes).sum();
        if bytes + self.bytes() <= KEPT_BYTES {
            kept.push(self);
        }
    }

    fn bytes(&self) -> usize {
        let masks = self.masks.as_ref().map_or(0, Masks::bytes);
        self.planes.bytes() + self.spectra.bytes() + masks
    }

    /// A plane with samples that nobody has set.
    pub(crate) fn plane(&mut self, width: usize, height: usize) -> Plane<f64> {
        Plane::from_samples(width, height, self.planes.take(width * height))
    }

    /// A spectrum with values that nobody has set.
    pub(crate) fn spectrum(&mut self, length: usize) -> Vec<Complex64> {
        self.spectra.take(length)
    }

    /// Planes that are not needed any more.
    pub(crate) fn take_back(&mut self, planes: impl IntoIterator<Item = Plane<f64>>) {
        let samples = planes.into_iter().map(Plane::into_samples);
        self.planes.returned.extend(samples);
    }

    /// Spectra that are not needed any more.
    pub(crate) fn take_back_spectra(&mut self, spectra: impl IntoIterator<Item = Vec<Complex64>>) {
        self.spectra.returned.extend(spectra);
    }
}

/// Buffers that are not in use.
#[derive(Debug, Default)]
struct Shelf<T> {
    /// From pictures before.
    old: Vec<Vec<T>>,
    /// Used for this picture.
    returned: Vec<Vec<T>>,
}

impl<T: Copy + Default> Shelf<T> {
    /// The smallest buffer that is large enough.
    fn take(&mut self, length: usize) -> Vec<T> {
        for shelf in [&mut self.returned, &mut self.old] {
            let fitting = shelf
                .iter()
                .enumerate()
                .filter(|(_, b)| b.capacity() >= length && b.capacity() <= 2 * length)
                .min_by_key(|(_, b)| b.capacity());
            if let Some((i, _)) = fitting {
                let mut buffer = shelf.swap_remove(i);
                buffer.resize(length, T::default());
                return buffer;
            }
        }
        // Those of another size would only be memory on top.
        self.old.clear();
        vec![T::default(); length]
    }

    fn forget_unused(&mut self) {
        self.old = std::mem::take(&mut self.returned);
    }

    fn bytes(&self) -> usize {
        let count: usize = self.old.iter().map(Vec::capacity).sum();
        count * size_of::<T>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A buffer comes back for a plane of about its size, not for one that is too large or much smaller, and is forgotten
    /// when a picture had no use for it.
    #[test]
    fn buffers_serve_again() {
        let mut memory = Workspace::default();
        let mut plane = memory.plane(10, 10);
        plane.set(3, 3, 7.0);
        memory.take_back([plane]);
        assert!(memory.plane(11, 10).samples().iter().all(|v| *v == 0.0));
        assert!(memory.plane(5, 5).samples().iter().all(|v| *v == 0.0));
        let again = memory.plane(9, 11);
        assert_eq!(again.samples()[33], 7.0);
        assert_eq!(again.size(), (9, 11));
        memory.take_back([again]);
        memory.planes.forget_unused();
        assert_eq!(memory.bytes(), 800);
        memory.planes.forget_unused();
        assert_eq!(memory.bytes(), 0);
    }
}
