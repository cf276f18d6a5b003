//! A picture in memory: rows from the top, no padding between them.

/// A rectangular buffer of samples, row by row from the top, without padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plane<T> {
    width: usize,
    height: usize,
    samples: Vec<T>,
}

/// 8-bit grey, gamma-encoded.
pub type Gray = Plane<u8>;

/// 8-bit red, green, blue, gamma-encoded (sRGB primaries unless a source says otherwise).
pub type Rgb = Plane<[u8; 3]>;

impl<T: Copy> Plane<T> {
    /// A plane filled with one value.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self {
            width,
            height,
            samples: vec![value; width * height],
        }
    }

    /// A plane from its samples, row by row.
    ///
    /// # Panics
    /// When `samples.len() != width * height`.
    pub fn from_samples(width: usize, height: usize, samples: Vec<T>) -> Self {
        assert_eq!(
            samples.len(),
            width * height,
            "a {width} x {height} plane needs as many samples"
        );
        Self {
            width,
            height,
            samples,
        }
    }

    /// A plane computed sample by sample from (column, row).
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> T) -> Self {
        let mut samples = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                samples.push(f(x, y));
            }
        }
        Self {
            width,
            height,
            samples,
        }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// (width, height).
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// All samples, row by row.
    pub fn samples(&self) -> &[T] {
        &self.samples
    }

    /// All samples, row by row, for writing.
    pub fn samples_mut(&mut self) -> &mut [T] {
        &mut self.samples
    }

    /// The samples themselves, row by row.
    pub fn into_samples(self) -> Vec<T> {
        self.samples
    }

    /// One row.
    pub fn row(&self, y: usize) -> &[T] {
        &self.samples[y * self.width..(y + 1) * self.width]
    }

    /// One row for writing.
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.samples[y * self.width..(y + 1) * self.width]
    }

    /// One sample.
    pub fn at(&self, x: usize, y: usize) -> T {
        self.samples[y * self.width + x]
    }

    /// Set one sample.
    pub fn set(&mut self, x: usize, y: usize, value: T) {
        self.samples[y * self.width + x] = value;
    }

    /// Same size, each sample mapped.
    pub fn map<U: Copy>(&self, f: impl Fn(T) -> U) -> Plane<U> {
        Plane {
            width: self.width,
            height: self.height,
            samples: self.samples.iter().map(|&s| f(s)).collect(),
        }
    }
}
