//! Where bytes come from and go to: a serial line, a pseudo-terminal, a simulated controller in memory.

use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{FileTypeExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, SpecialCodeIndex, ioctl_tiocexcl, tcflush,
    tcgetattr, tcsetattr,
};

/// A line to a controller. No call blocks; each says what time it is (s on the run's clock), which only simulated lines use.
pub trait Port: Send {
    /// Its name, for a person: "/dev/ttyUSB0".
    fn name(&self) -> &str;

    /// Take what has come in; 0 when there is nothing. An error means that the line is gone until it is opened again.
    fn read(&mut self, into: &mut [u8], now_s: f64) -> io::Result<usize>;

    /// Hand over as much as goes without waiting; 0 when nothing does.
    fn write(&mut self, bytes: &[u8], now_s: f64) -> io::Result<usize>;

    /// Open it, again if need be.
    fn open(&mut self, now_s: f64) -> io::Result<()>;

    /// Bits a second, as far as the line has a rate.
    fn baud(&self) -> u32;
}

/// A serial line or a pseudo-terminal of this machine: 8 bits, no parity, one stop bit, no handshake. Opening it raises DTR, which resets
/// most Arduino boards.
#[derive(Debug)]
pub struct SerialPort {
    path: PathBuf,
    name: String,
    baud: u32,
    file: Option<File>,
}

impl SerialPort {
    /// The line behind `path`; nothing is opened yet.
    pub fn new(path: &Path, baud: u32) -> Self {
        Self {
            path: path.to_owned(),
            name: path.display().to_string(),
            baud,
            file: None,
        }
    }

    fn opened(&self) -> io::Result<File> {
        let told = |kind: ErrorKind, text: String| io::Error::new(kind, text);
        let name = &self.name;
        let flags = OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(flags.bits().cast_signed())
            .open(&self.path)
            .map_err(|error| open_error(name, &error))?;
        if !file.metadata()?.file_type().is_char_device() {
            let text =
                format!("{name} is no serial port: name one such as /dev/ttyUSB0 or /dev/ttyACM0");
            return Err(told(ErrorKind::InvalidInput, text));
        }
        let in_use = format!(
            "{name} is in use by another program: end it (a G-code sender, a serial monitor), or name another port"
        );
        flock(&file, FlockOperation::NonBlockingLockExclusive)
            .map_err(|_| told(ErrorKind::ResourceBusy, in_use))?;
        let mut modes = tcgetattr(&file).map_err(|_| {
            let text =
                format!("{name} is no serial port: name one such as /dev/ttyUSB0 or /dev/ttyACM0");
            told(ErrorKind::InvalidInput, text)
        })?;
        modes.make_raw();
        modes.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
        modes.control_modes &= !(ControlModes::CRTSCTS | ControlModes::CSTOPB);
        // With VMIN 1 an empty line reads as "would block", and 0 bytes mean that the line was hung up.
        modes.special_codes[SpecialCodeIndex::VMIN] = 1;
        modes.special_codes[SpecialCodeIndex::VTIME] = 0;
        modes.set_speed(self.baud).map_err(|_| {
            let text = format!(
                "{name} cannot run at {} baud: 115200 is what Grbl uses",
                self.baud
            );
            told(ErrorKind::InvalidInput, text)
        })?;
        tcsetattr(&file, OptionalActions::Now, &modes)?;
        // A line that cannot be kept to oneself (a pseudo-terminal's other side holds it) still works.
        let _ = ioctl_tiocexcl(&file);
        tcflush(&file, QueueSelector::IOFlush)?;
        Ok(file)
    }
}

fn open_error(name: &str, error: &io::Error) -> io::Error {
    let text = match error.kind() {
        ErrorKind::NotFound => {
            format!("{name} is not there: plug the controller in, or name another port")
        }
        ErrorKind::PermissionDenied => format!(
            "no permission to open {name}: add yourself to its group (on Debian: sudo usermod -aG dialout $USER), then log in again"
        ),
        ErrorKind::ResourceBusy => format!(
            "{name} is in use by another program: end it (a G-code sender, a serial monitor), or name another port"
        ),
        _ => format!("{name} cannot be opened: {error}"),
    };
    io::Error::new(error.kind(), text)
}

impl Port for SerialPort {
    fn name(&self) -> &str {
        &self.name
    }

    fn read(&mut self, into: &mut [u8], _now_s: f64) -> io::Result<usize> {
        let file = self.file.as_mut().ok_or(ErrorKind::NotConnected)?;
        match file.read(into) {
            Ok(0) if !into.is_empty() => {
                self.file = None;
                let text = format!("{} was unplugged", self.name);
                Err(io::Error::new(ErrorKind::BrokenPipe, text))
            }
            Err(error) if is_waiting(&error) => Ok(0),
            Err(error) => {
                self.file = None;
                let text = format!("{} is gone ({error})", self.name);
                Err(io::Error::new(error.kind(), text))
            }
            done => done,
        }
    }

    fn write(&mut self, bytes: &[u8], _now_s: f64) -> io::Result<usize> {
        let file = self.file.as_mut().ok_or(ErrorKind::NotConnected)?;
        match file.write(bytes) {
            Err(error) if is_waiting(&error) => Ok(0),
            Err(error) => {
                self.file = None;
                let text = format!("{} is gone ({error})", self.name);
                Err(io::Error::new(error.kind(), text))
            }
            done => done,
        }
    }

    fn open(&mut self, _now_s: f64) -> io::Result<()> {
        // The old one first: it holds the lock.
        self.file = None;
        self.file = Some(self.opened()?);
        Ok(())
    }

    fn baud(&self) -> u32 {
        self.baud
    }
}

fn is_waiting(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
