//! Where a recording's bytes go: a file, or whatever a test puts in its place.

use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

/// Something that grows at its end.
pub trait Storage: Send {
    /// Put bytes at the end; returns how many were taken, which may be fewer, or none when it takes nothing now. [`io::ErrorKind::WouldBlock`]
    /// and [`io::ErrorKind::Interrupted`] are "not now"; any other error is a failure, after which it is tried again later.
    fn append(&mut self, bytes: &[u8]) -> io::Result<usize>;

    /// Make sure that what was taken outlives a power cut, as far as that is possible.
    fn sync(&mut self) -> io::Result<()>;

    /// Cut to this length: what was appended beyond it is no whole chunk.
    fn cut(&mut self, length: u64) -> io::Result<()>;
}

/// A file on a disk.
pub struct FileStorage {
    file: File,
}

impl FileStorage {
    /// A new file; one that is there already is refused.
    pub fn create(path: &Path) -> io::Result<Self> {
        let file = File::options().write(true).create_new(true).open(path)?;
        Ok(Self { file })
    }
}

impl Storage for FileStorage {
    fn append(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync_data()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.file.set_len(length)?;
        io::Seek::seek(&mut self.file, io::SeekFrom::Start(length))?;
        Ok(())
    }
}

impl<S: Storage + ?Sized> Storage for Box<S> {
    fn append(&mut self, bytes: &[u8]) -> io::Result<usize> {
        (**self).append(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        (**self).sync()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        (**self).cut(length)
    }
}
