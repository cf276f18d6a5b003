//! Where models are kept: one file each in the data folder.

use std::fs;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use vergence_imaging::files::write_whole;
use vergence_quality::model::MAX_MODEL_BYTES;
use vergence_quality::{Model, ModelError};

use crate::fault::{self, Fault};

/// The name of the model that is built in.
pub(crate) const DEFAULT: &str = "default";

/// Longest name.
const MAX_NAME: usize = 64;

/// Most files of the folder that are looked at.
const MAX_MODELS: usize = 1000;

/// What to do with a model that has the name already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Existing {
    /// Refuse the new one.
    Keep,
    /// Put the new one in its place.
    Replace,
}

/// The folder of the models; it need not exist.
pub(crate) fn folder() -> anyhow::Result<PathBuf> {
    let variable = |name: &str| {
        let value = std::env::var_os(name).filter(|v| !v.is_empty());
        value.map(PathBuf::from)
    };
    let usual = || {
        if cfg!(windows) {
            return variable("APPDATA");
        }
        let home = std::env::home_dir().filter(|h| h.is_absolute())?;
        if cfg!(target_os = "macos") {
            return Some(home.join("Library/Application Support"));
        }
        // The rules of XDG: a path that is not absolute is passed over.
        let given = variable("XDG_DATA_HOME").filter(|p| p.is_absolute());
        Some(given.unwrap_or_else(|| home.join(".local/share")))
    };
    let data = variable("VERGENCE_DATA_DIR")
        .or_else(|| usual().map(|folder| folder.join("vergence")))
        .ok_or_else(|| {
            fault::failed("there is no folder to keep models in")
                .hint("name one in VERGENCE_DATA_DIR")
        })?;
    Ok(data.join("models"))
}

/// The model of this name, the built-in one included.
pub(crate) fn load(name: &str) -> anyhow::Result<Model> {
    if name == DEFAULT {
        return Ok(Model::default_model().map_err(|e| fault::failed(e.to_string()))?);
    }
    let file = file_of(name)?;
    if !file.exists() {
        return Err(unknown(name)?.into());
    }
    let bytes = read(&file)?;
    let model = Model::from_json(&bytes).map_err(|e| refused(&file, &e))?;
    Ok(model)
}

/// Names of the models that were imported, in order.
pub(crate) fn names() -> anyhow::Result<Vec<String>> {
    let folder = folder()?;
    let entries = match fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(e) => {
            let message = format!("cannot read the folder {}: {e}", folder.display());
            return Err(fault::failed(message).into());
        }
    };
    let name = |path: PathBuf| {
        let json = path.extension().is_some_and(|e| e == "json");
        let name = path.file_stem()?.to_str()?.to_owned();
        (json && check_name(&name).is_ok()).then_some(name)
    };
    let mut names: Vec<String> = entries
        .take(MAX_MODELS)
        .filter_map(|entry| name(entry.ok()?.path()))
        .collect();
    names.sort();
    Ok(names)
}

/// Read a model of any format and keep it; gives the model and where it lies.
pub(crate) fn import(
    path: &Path,
    name: &str,
    existing: Existing,
) -> anyhow::Result<(Model, PathBuf)> {
    let file = file_of(name)?;
    if existing == Existing::Keep && file.exists() {
        return Err(fault::usage(format!("there is a model '{name}' already"))
            .hint("choose another --name, or give --replace")
            .into());
    }
    let model = read_any(path, name)?;
    let text = model.to_json().map_err(|e| refused(path, &e))?;
    let folder = file.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder)
        .and_then(|()| write_whole(&file, text.as_bytes()))
        .map_err(|e| fault::failed(format!("cannot write {}: {e}", file.display())))?;
    Ok((model, file))
}

/// Delete a model that was imported; gives where it lay.
pub(crate) fn remove(name: &str) -> anyhow::Result<PathBuf> {
    let file = file_of(name)?;
    match fs::remove_file(&file) {
        Ok(()) => Ok(file),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Err(unknown(name)?.into()),
        Err(e) => Err(fault::failed(format!("cannot remove {}: {e}", file.display())).into()),
    }
}

/// The name that a file suggests.
pub(crate) fn name_from_path(path: &Path) -> anyhow::Result<String> {
    let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or("");
    check_name(stem).map_err(|e| e.hint("give a --name"))?;
    Ok(stem.to_owned())
}

/// A name that can be a file's on every system and cannot leave the folder.
fn check_name(name: &str) -> Result<(), Fault> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let ends = |c: Option<char>| c.is_some_and(|c| c.is_ascii_alphanumeric());
    let good = name.len() <= MAX_NAME
        && name.chars().all(plain)
        && ends(name.chars().next())
        && ends(name.chars().last());
    if good {
        return Ok(());
    }
    let shown: String = name.chars().take(MAX_NAME).collect();
    Err(fault::usage(format!(
        "{shown:?} cannot be the name of a model: it takes letters, digits, '-', '_' and '.', begins and ends with a letter or \
         a digit and has at most {MAX_NAME}"
    )))
}

/// The file of a model that is not built in.
fn file_of(name: &str) -> anyhow::Result<PathBuf> {
    check_name(name)?;
    if name.eq_ignore_ascii_case(DEFAULT) {
        return Err(fault::usage(
            "the model 'default' is built in and can be neither replaced nor removed",
        )
        .into());
    }
    Ok(folder()?.join(format!("{name}.json")))
}

fn unknown(name: &str) -> anyhow::Result<Fault> {
    let mut all = vec![DEFAULT.to_owned()];
    all.extend(names()?);
    let hint = match all.iter().find(|n| n.eq_ignore_ascii_case(name)) {
        Some(near) => format!("there is a model '{near}'"),
        None => format!(
            "there is {}; `vergence model import` takes in others",
            all.join(", ")
        ),
    };
    Ok(fault::usage(format!("there is no model '{name}'")).hint(hint))
}

fn read_any(path: &Path, name: &str) -> anyhow::Result<Model> {
    let model = if path.is_dir() {
        Model::from_libsvm_folder(name, path)
    } else {
        let bytes = read(path)?;
        let first = bytes.iter().find(|b| !b.is_ascii_whitespace());
        if bytes.starts_with(b"MATLAB") || bytes.starts_with(b"\x89HDF") {
            Model::from_matlab(&bytes, name)
        } else if first == Some(&b'{') {
            Model::from_json(&bytes)
        } else if bytes.starts_with(b"svm_type") {
            return Err(fault::usage(format!(
                "{} is one of six models of libsvm; name the folder that holds them all",
                path.display()
            ))
            .into());
        } else {
            Err(ModelError::Unknown)
        }
    };
    let mut model = model.map_err(|e| refused(path, &e))?;
    name.clone_into(&mut model.name);
    Ok(model)
}

fn refused(path: &Path, error: &ModelError) -> Fault {
    fault::usage(format!("{}: {error}", path.display()))
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    let cannot = |e: std::io::Error| fault::usage(format!("cannot read {}: {e}", path.display()));
    let mut bytes = Vec::new();
    let file = fs::File::open(path).map_err(cannot)?;
    file.take(MAX_MODEL_BYTES as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(cannot)?;
    if bytes.len() > MAX_MODEL_BYTES {
        return Err(refused(path, &ModelError::TooLarge).into());
    }
    Ok(bytes)
}
