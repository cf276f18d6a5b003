//! Reading a calibration file of any known format.

use std::io::Read as _;
use std::path::Path;

use crate::{CalibError, RigCalibration, depthai, qualisys, rig_file};

/// Largest calibration file that is read, bytes (the files of real rigs are some tens of kilobytes).
pub const MAX_FILE_BYTES: u64 = 4 << 20;

impl RigCalibration {
    /// Read a calibration file; its content tells the format.
    ///
    /// `choice` names the left and the right camera where a file holds more than two: the serial numbers of a Qualisys
    /// file (`["cam03", "cam04"]`), the sockets of a DepthAI file (`["1", "2"]`). Without it a DepthAI file's own left and
    /// right are taken, and a Qualisys file must hold exactly two cameras, left first. Our own files have one left and
    /// one right camera: a choice must then be their names.
    ///
    /// # Errors
    /// Every fault is a [`CalibError`] that ends with the file's path.
    pub fn read(path: &Path, choice: Option<[&str; 2]>) -> Result<Self, CalibError> {
        let text = read_text(path)?;
        let mut rig = Self::parse(&text, choice).map_err(|fault| CalibError::File {
            fault: Box::new(fault),
            path: path.to_owned(),
        })?;
        rig.source = Some(path.to_owned());
        Ok(rig)
    }

    /// [`Self::read`] of a text that is in memory already.
    ///
    /// # Errors
    /// As [`Self::read`], without a path.
    pub fn parse(text: &str, choice: Option<[&str; 2]>) -> Result<Self, CalibError> {
        let text = text.trim_start_matches('\u{feff}');
        if let Some([left, right]) = choice
            && left == right
        {
            return Err(CalibError::Rig {
                reason: format!("camera {left} was chosen as left and as right"),
            });
        }
        match text.trim_start().as_bytes().first() {
            None => Err(CalibError::UnknownFormat {
                reason: "it is empty".to_owned(),
            }),
            Some(b'<') => qualisys::rig_from_xml(text, choice),
            Some(b'{') => depthai::rig_from_json(text, choice),
            Some(_) => rig_file::rig_from_toml(text, choice),
        }
    }
}

fn read_text(path: &Path) -> Result<String, CalibError> {
    let io = |source| CalibError::Io {
        action: "reading a calibration",
        source,
        path: path.to_owned(),
    };
    let file = std::fs::File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    // The length is not asked for first: a pipe has none, and a file may grow.
    file.take(MAX_FILE_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    let in_file = |fault| CalibError::File {
        fault: Box::new(fault),
        path: path.to_owned(),
    };
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(in_file(CalibError::TooLarge {
            limit: MAX_FILE_BYTES,
        }));
    }
    String::from_utf8(bytes).map_err(|_| {
        in_file(CalibError::UnknownFormat {
            reason: "it is not UTF-8 text".to_owned(),
        })
    })
}
