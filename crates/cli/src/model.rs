//! `vergence model`: the quality models that pictures can be graded with.

mod describe;
pub(crate) mod store;

use std::path::PathBuf;

use clap::Subcommand;
use vergence_quality::Model;

use crate::output::{self, Format};
use describe::{Description, Listed};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
List, show, import and remove the models that `vergence grade --model NAME` grades with. A model names the distortion of a picture and rates \
it: about 0 is best, about 100 is worst.

The model `default` is built in. Others are files of yours in the data folder, models/NAME.json under VERGENCE_DATA_DIR, else \
XDG_DATA_HOME/vergence, else ~/.local/share/vergence (macOS: ~/Library/Application Support/vergence, Windows: %APPDATA%\\vergence).

What can be imported: our own JSON; the MATLAB file of the DIIVINE release (data_live_trained.mat; level 5, compressed or not); a folder of text \
models of libsvm: class.model (svm-train -b 1, labels 1 to 5 = JPEG 2000, JPEG, white noise, Gaussian blur, fast fading), reg1.model to \
reg5.model (or jp2k, jpeg, wn, blur, ff), each with the range file of svm-scale -s under the same name with .range, or one all.range.";

const AFTER: &str = "\
Examples:
  vergence model list
  vergence model import data_live_trained.mat --name live
  vergence model show live --format json
  vergence model remove live

JSON: name, built_in, file, trained_on, licence, scale {best, worst}, direction, features, classes, classifier {gamma, support_vectors \
by class}, regressors by class {gamma, support_vectors, rho}; list gives {folder, models}, where a file that cannot be read has `error` instead.";

/// Flags of `vergence model`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct ModelArgs {
    #[command(subcommand)]
    action: Action,
    /// How to print.
    #[arg(long, value_enum, default_value_t, global = true)]
    format: Format,
}

/// What to do with models.
#[derive(Debug, Subcommand)]
enum Action {
    /// List all models.
    List,
    /// Say what a model is, where it comes from and how to read its scores.
    Show {
        /// Its name.
        #[arg(default_value = store::DEFAULT)]
        name: String,
    },
    /// Take a model file into the data folder.
    Import {
        /// Our JSON, the MATLAB file of the DIIVINE release, or a folder of libsvm's text files.
        #[arg(value_name = "FILE|FOLDER")]
        path: PathBuf,
        /// Name to keep it under [default: that of the file].
        #[arg(long)]
        name: Option<String>,
        /// Replace a model that has this name already.
        #[arg(long)]
        replace: bool,
    },
    /// Delete a model that was imported.
    Remove {
        /// Its name.
        name: String,
    },
}

/// Do it.
pub(crate) fn run(args: &ModelArgs) -> anyhow::Result<()> {
    match &args.action {
        Action::List => list(args.format),
        Action::Show { name } => {
            let model = store::load(name)?;
            print(args.format, &Description::of(&model, name)?)
        }
        Action::Import {
            path,
            name,
            replace,
        } => {
            let name = match name {
                Some(name) => name.clone(),
                None => store::name_from_path(path)?,
            };
            let kept = match replace {
                true => store::Existing::Replace,
                false => store::Existing::Keep,
            };
            let (model, file) = store::import(path, &name, kept)?;
            output::say(&format!("kept as {}", file.display()));
            if let Some(notice) = notice(&model) {
                output::say(&notice);
            }
            print(args.format, &Description::of(&model, &name)?)
        }
        Action::Remove { name } => {
            let file = store::remove(name)?;
            output::say(&format!("removed {}", file.display()));
            Ok(())
        }
    }
}

fn list(format: Format) -> anyhow::Result<()> {
    let listed = Listed::all()?;
    match format {
        Format::Text => output::print(&listed.text())?,
        Format::Json => output::print_json(&listed)?,
    }
    Ok(())
}

fn print(format: Format, description: &Description) -> anyhow::Result<()> {
    match format {
        Format::Text => output::print(&description.text())?,
        Format::Json => output::print_json(description)?,
    }
    Ok(())
}

/// What whoever imports a model that is not the project's should know.
fn notice(model: &Model) -> Option<String> {
    let foreign = model.licence.starts_with("not part of this project");
    foreign.then(|| format!("note: this model is {}", model.licence))
}
