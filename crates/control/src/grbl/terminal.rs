//! The simulated controller as a serial port: a pseudo-terminal in real time.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::unix::ffi::OsStringExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

use crate::grbl::simulated::SharedGrbl;

/// Between two looks at the terminal.
const LOOK: Duration = Duration::from_millis(1);

/// A clock that starts at zero now, for what runs beside no loop: this terminal, its example and its tests.
pub fn real_time() -> impl Fn() -> f64 + Clone + Send + Sync + 'static {
    let start = Instant::now();
    move || start.elapsed().as_secs_f64()
}

/// A simulated controller behind a pseudo-terminal. While its port "is gone" ([`crate::grbl::GrblFault::PortGone`]) the terminal is closed,
/// afterwards there is a new one; `link` always points to the newest.
pub struct GrblTerminal {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    path: PathBuf,
}

/// The controller's side of a terminal and the program's.
struct Pair {
    own: File,
    /// Held open so that the terminal outlives programs that come and go.
    other: File,
    path: PathBuf,
}

fn open_pair() -> std::io::Result<Pair> {
    let own = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&own)?;
    unlockpt(&own)?;
    let path = PathBuf::from(std::ffi::OsString::from_vec(
        ptsname(&own, Vec::new())?.into_bytes(),
    ));
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let other = File::from(rustix::fs::open(&path, flags, Mode::empty())?);
    let mut modes = tcgetattr(&other)?;
    modes.make_raw();
    tcsetattr(&other, OptionalActions::Now, &modes)?;
    rustix::io::ioctl_fionbio(&own, true)?;
    Ok(Pair {
        own: File::from(own),
        other,
        path,
    })
}

impl GrblTerminal {
    /// Open a terminal and serve it from a thread. `clock` is the time that the controller is told; `link`, if given, is made a symbolic link to the
    /// terminal (it must not exist, or be such a link).
    pub fn start(
        grbl: SharedGrbl,
        clock: impl Fn() -> f64 + Send + 'static,
        link: Option<&Path>,
    ) -> std::io::Result<Self> {
        let pair = open_pair()?;
        let link = link.map(Path::to_owned);
        set_link(link.as_deref(), Some(&pair.path))?;
        let path = link.clone().unwrap_or_else(|| pair.path.clone());
        let ends = Arc::new(AtomicBool::new(false));
        let theirs = Arc::clone(&ends);
        let thread = std::thread::Builder::new()
            .name("simulated grbl".to_owned())
            .spawn(move || serve(&grbl, &clock, link.as_deref(), pair, &theirs))?;
        Ok(Self {
            ends,
            thread: Some(thread),
            path,
        })
    }

    /// What a program opens: the link, or the terminal itself.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for GrblTerminal {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has nothing left to give back.
            let _ = thread.join();
        }
    }
}

fn set_link(link: Option<&Path>, target: Option<&Path>) -> std::io::Result<()> {
    let Some(link) = link else {
        return Ok(());
    };
    if link.is_symlink() {
        std::fs::remove_file(link)?;
    }
    match target {
        Some(target) => std::os::unix::fs::symlink(target, link),
        None => Ok(()),
    }
}

fn serve(
    grbl: &SharedGrbl,
    clock: &impl Fn() -> f64,
    link: Option<&Path>,
    pair: Pair,
    ends: &AtomicBool,
) {
    let mut pair = Some(pair);
    let mut buffer = [0; 1024];
    while !ends.load(Ordering::Acquire) {
        let now_s = clock();
        let mut grbl = grbl.lock();
        grbl.advance_to(now_s);
        let there = grbl.port_there(now_s);
        match &mut pair {
            Some(open) if there => {
                // Nothing to read, or a program that has just gone: both are looked at again.
                if let Ok(n) = open.own.read(&mut buffer) {
                    grbl.receive(&buffer[..n], now_s);
                }
                let n = grbl.send(&mut buffer, now_s);
                // A program that does not read loses what it does not read.
                let _ = open.own.write(&buffer[..n]);
            }
            None if there => {
                pair = open_pair().ok();
                grbl.opened(now_s);
                // A link that cannot be set is seen by whoever opens it.
                let _ = set_link(link, pair.as_ref().map(|p| p.path.as_path()));
            }
            open => {
                if open.take().is_some_and(|p| p.other.metadata().is_ok()) {
                    let _ = set_link(link, None);
                }
            }
        }
        drop(grbl);
        std::thread::sleep(LOOK);
    }
    let _ = set_link(link, None);
}
