//! Definitions of bars by built-in name or file.

use std::path::Path;

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_device::protocol::ProtocolFinding::UnknownProtocol;
use dbbd_model::diagnostic::Diagnostic;

use crate::files;

/// A definition by built-in name or by file, with parameters by their names.
pub fn read_protocol(name: &str, params: &[(String, String)]) -> Result<ProtocolDefinition, Diagnostic> {
    if let Some(built_in) = ProtocolDefinition::by_name_with(name, params) {
        return built_in;
    }
    let path = Path::new(name);
    if path.exists() || name.ends_with(".toml") {
        return read_protocol_file(path, params);
    }
    let known: Vec<&str> = ProtocolDefinition::built_in().iter().map(|(name, _)| *name).collect();
    let unknown = UnknownProtocol { name: name.into(), built_in: known.join(", ") };
    Err(Diagnostic::new(unknown).nearest(name, known))
}

/// The definition in a file.
pub fn read_protocol_file(
    path: &Path,
    params: &[(String, String)],
) -> Result<ProtocolDefinition, Diagnostic> {
    ProtocolDefinition::from_toml_with(&path.display().to_string(), &files::read_definition(path)?, params)
}
