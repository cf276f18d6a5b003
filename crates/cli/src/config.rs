//! `vergence config`: the effective settings.

use crate::args::Global;
use crate::output::{self, Format};
use crate::rig;
use crate::twin;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Print the effective settings as a TOML file: every key with its value, unit, meaning, range and default. A value that is not the \
default says where it came from. The output is itself a settings file.";

const AFTER: &str = "\
Examples:
  vergence config > rig.toml                   start a settings file
  vergence --config rig.toml config            see what a file sets
  VERGENCE_RIG_INTERAXIAL=65mm vergence config
  vergence config --format json

JSON fields: settings.<section>.<key>.{value, unit, text, origin, origin_detail, default, meaning}; `value` is in SI units and \
radians, null for auto; `origin` is default, file, environment or flag.";

/// Flags of `vergence config`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct ConfigArgs {
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Print the settings.
pub(crate) fn run(global: &Global, args: &ConfigArgs) -> anyhow::Result<()> {
    let settings = global.settings(&[])?;
    // What is printed is known to make a rig and a twin.
    rig::setup(&settings).validate().map_err(rig::refused)?;
    twin::config(&settings)?;
    match args.format {
        Format::Text => output::print(&settings.to_toml())?,
        Format::Json => output::print_json(&settings.to_json())?,
    }
    Ok(())
}
