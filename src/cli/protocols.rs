//! `dbbd protocols`.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::{CommandOutcome, CommandOutput, value};
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_device::protocol::ProtocolFinding;
use dbbd_job::request::{read_protocol, read_protocol_file};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;

/// List, show or check protocol definitions.
///
/// A definition is a TOML file that describes how the bytes of a bar become lengths. A new device needs no code. More:
/// docs/reference/protocols.md, docs/how-to/build-a-bar.md.
#[derive(clap::Args)]
pub(crate) struct ProtocolsArgs {
    #[command(subcommand)]
    what: Option<ProtocolsVerb>,
}

#[derive(clap::Subcommand)]
enum ProtocolsVerb {
    /// List the built-in definitions (the default).
    List,
    /// Print a definition, with the layout of its frame and an example as comments: a template for a new one.
    Show {
        /// A built-in name or a file.
        name: String,
        /// Set a parameter of the definition.
        #[arg(long = "param", value_name = "NAME=VALUE", value_parser = value::name_value)]
        params: Vec<(String, String)>,
    },
    /// Check a definition file and run its test vectors.
    Check {
        /// The TOML file.
        file: PathBuf,
        /// Set a parameter of the definition.
        #[arg(long = "param", value_name = "NAME=VALUE", value_parser = value::name_value)]
        params: Vec<(String, String)>,
    },
}

pub(crate) fn run(args: &ProtocolsArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    match &args.what {
        None | Some(ProtocolsVerb::List) => list_protocols(out),
        Some(ProtocolsVerb::Show { name, params }) => {
            let definition = read_protocol(name, params)?;
            out.document(&summary(&definition))?;
            layout(&definition, out);
            out.result(definition.text.trim_end());
            Ok(CommandOutcome::Done)
        }
        Some(ProtocolsVerb::Check { file, params }) => check_definition(file, params, out),
    }
}

fn check_definition(
    file: &Path,
    params: &[(String, String)],
    out: &CommandOutput,
) -> Result<CommandOutcome, Diagnostic> {
    let definition = read_protocol_file(file, params)?;
    let table: Option<toml::Table> = definition.text.parse().ok();
    let has_tests = table.as_ref().is_some_and(|table| table.contains_key("test"));
    if !has_tests {
        out.finding(Diagnostic::file(file.display(), ProtocolFinding::NoTests));
    }
    let same_id = ProtocolDefinition::built_in().iter().find(|(id, _)| *id == definition.id);
    if same_id.is_some_and(|(_, text)| text.parse().ok() != table) {
        let id = definition.id.clone();
        out.finding(Diagnostic::file(file.display(), ProtocolFinding::IdOfBuiltIn { id }));
    }
    out.document(&summary(&definition))?;
    let tests = if has_tests { "its test vectors pass" } else { "it has no test vectors" };
    out.result(format!("{}: `{}` is sound; {tests}", file.display(), definition.id));
    Ok(CommandOutcome::Done)
}

/// Prints the frame as a table and as bytes, in comments: the output is a definition file.
fn layout(definition: &ProtocolDefinition, out: &CommandOutput) {
    out.result(format!("# frame: {}", definition.framing()));
    out.result(format!("# {:>4}  {:>5}  {:40}  says", "byte", "bytes", "written"));
    let number = |value: Option<usize>| value.map_or("-".to_owned(), |value| value.to_string());
    for part in definition.layout() {
        let line = format!(
            "# {:>4}  {:>5}  {:40}  {}",
            number(part.at),
            number(part.bytes),
            part.encoding,
            part.meaning
        );
        out.result(line.trim_end());
    }
    let sample = Sample {
        sequence: Some(1),
        ticks: Some(DeviceTicks(1000)),
        trigger: Some(false),
        temperature_c: Some(20.0),
        ..Sample::of(definition.sim.at_mm + 0.125)
    };
    let mut frame = Vec::new();
    if definition.encoder().encode(&sample, &mut frame).is_ok() {
        let hex: Vec<String> = frame.iter().map(|byte| format!("{byte:02x}")).collect();
        out.result(format!("# {} mm: {}", sample.reading_mm, hex.join(" ")));
    }
    out.result(format!("# {}", undetected(definition)));
}

/// How well the check of a definition detects damaged frames.
fn undetected(definition: &ProtocolDefinition) -> String {
    let share = definition.undetected();
    if share < 1.0 {
        format!("a damaged frame of the right form passes with a probability of {share:.2e}")
    } else {
        "no check: a damaged frame of the right form passes".into()
    }
}

fn summary(definition: &ProtocolDefinition) -> serde_json::Value {
    json!({
        "id": definition.id,
        "title": definition.title,
        "confidence": definition.confidence,
        "source": definition.source,
        "tested_on": definition.tested_on,
        "baud": definition.line.baud,
        "baud_probe": definition.line.baud_probe,
        "nominal_hz": definition.nominal_hz,
        "params": definition.params.iter().cloned().collect::<std::collections::BTreeMap<_, _>>(),
        "resolution_mm": definition.resolution_mm(),
        "undetected": definition.undetected(),
    })
}

fn list_protocols(out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let mut all = Vec::new();
    for (name, text) in ProtocolDefinition::built_in() {
        let definition = ProtocolDefinition::from_toml(name, text)?;
        let tried = match definition.tested_on.as_slice() {
            [] => ", not tried on hardware".to_owned(),
            devices => format!(", tried on {}", devices.join(", ")),
        };
        let passes = match definition.undetected() {
            share if share < 1.0 => format!("1 damaged frame in {:.0} passes", 1.0 / share),
            _ => "no check that is always there".to_owned(),
        };
        out.result(format!("{name:20}  {} [{}{tried}; {passes}]", definition.title, definition.confidence));
        all.push(summary(&definition));
    }
    out.list(&all)?;
    Ok(CommandOutcome::Done)
}
