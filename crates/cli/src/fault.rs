//! Errors as a person meets them: one sentence, perhaps a hint, an exit code.

use std::fmt;
use std::io;
use std::process::ExitCode;

/// Whose fault it is, which decides the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The work failed: exit code 1.
    Failed,
    /// The call cannot be answered as it was typed (flags, settings, input files): exit code 2.
    Usage,
    /// Ctrl-C, SIGTERM or SIGHUP ended the work early: exit code 130, as of a program that SIGINT ends.
    Interrupted,
}

/// An error with an exit code and, where a remedy is known, a hint.
#[derive(Debug)]
pub(crate) struct Fault {
    kind: Kind,
    message: String,
    hint: Option<String>,
}

/// The call cannot be answered as it was typed.
pub(crate) fn usage(message: impl Into<String>) -> Fault {
    Fault {
        kind: Kind::Usage,
        message: message.into(),
        hint: None,
    }
}

/// The work failed.
pub(crate) fn failed(message: impl Into<String>) -> Fault {
    Fault {
        kind: Kind::Failed,
        message: message.into(),
        hint: None,
    }
}

/// Ctrl-C, SIGTERM or SIGHUP ended the work early.
pub(crate) fn interrupted(message: impl Into<String>) -> Fault {
    Fault {
        kind: Kind::Interrupted,
        message: message.into(),
        hint: None,
    }
}

impl Fault {
    /// Change the message.
    pub(crate) fn map(mut self, change: impl FnOnce(String) -> String) -> Self {
        self.message = change(self.message);
        self
    }

    /// Add what to do about it, as a sentence without the word "hint".
    pub(crate) fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// What to do about it, where that is known.
    #[cfg(test)]
    pub(crate) fn remedy(&self) -> Option<&str> {
        self.hint.as_deref()
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Fault {}

/// Tell stderr what went wrong and give the exit code for it. A reader that closed the pipe is no error.
pub(crate) fn report(error: &anyhow::Error) -> ExitCode {
    let closed = error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(|cause| cause.kind() == io::ErrorKind::BrokenPipe);
    if closed {
        return ExitCode::SUCCESS;
    }
    let fault = error.chain().find_map(|c| c.downcast_ref::<Fault>());
    let mut text = format!("error: {error:#}\n");
    if let Some(hint) = fault.and_then(|f| f.hint.as_ref()) {
        text += &format!("hint: {hint}\n");
    }
    // Nothing is left to be done when stderr is closed too.
    let _ = io::Write::write_all(&mut io::stderr(), text.as_bytes());
    match fault.map_or(Kind::Failed, |f| f.kind) {
        Kind::Failed => ExitCode::from(1),
        Kind::Usage => ExitCode::from(2),
        Kind::Interrupted => ExitCode::from(130),
    }
}
