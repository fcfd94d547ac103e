//! `dbbd certificate`.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::identify::ROBOT;
use super::{CommandOutcome, CommandOutput, artefact};
use dbbd_device::clock;
use dbbd_job::file_set::FileSet;
use dbbd_job::files;
use dbbd_job::report::certificate::Certificate;
use dbbd_job::report::certificate::CertificateFinding;
use dbbd_model::base::date;
use dbbd_model::base::serialised;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ArtefactRole;

/// Write the draft of a calibration certificate.
///
/// Writes certificate.html for print on A4, dcc.xml, a Digital Calibration Certificate (DCC 3.3.0), and certificate.pdf, a
/// PDF/A-3 that contains dcc.xml (only in builds with the feature `pdf`). They state the object, traceability of the bar,
/// conditions, results, uncertainty budget, the decision of a check with its rule, and what was not determined. The draft is
/// not accredited and not signed. More: docs/reference/certificate.md.
#[derive(clap::Args)]
pub(crate) struct CertificateArgs {
    /// result.json of `dbbd identify`, or its directory.
    #[arg(value_name = "RESULT")]
    result: PathBuf,
    /// Directory for certificate.html, dcc.xml and certificate.pdf.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// check.json of `dbbd check`, or its directory: adds its decision and decision rule.
    #[arg(long, value_name = "CHECK.json")]
    check: Option<PathBuf>,
    /// Serial numbers, laboratory, customer, operator, date and so on, in place of those in the result: a TOML file with the
    /// keys of a job's table [identity].
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
}

/// The name and the text of a file, which may be named by its directory.
fn read_named_file(path: &Path, name: &str) -> Result<(String, String), Diagnostic> {
    let path = if path.is_dir() { path.join(name) } else { path.to_owned() };
    let (name, text) = (path.display().to_string(), files::read_text(&path)?);
    serialised::check_seal(&text).map_err(|finding| Diagnostic::file(&name, finding))?;
    Ok((name, text))
}

pub(crate) fn run(args: &CertificateArgs, out: &CommandOutput) -> Result<CommandOutcome, Diagnostic> {
    let (certificate_of, text) = read_named_file(&args.result, "result.json")?;
    let mut certificate = Certificate::read(&text).map_err(|why| Diagnostic::file(&certificate_of, why))?;
    if let Some(path) = &args.check {
        let (file, text) = read_named_file(path, "check.json")?;
        let robot = Path::new(&certificate_of).with_file_name(ROBOT);
        let robot = robot
            .is_file()
            .then(|| dbbd_job::artefact::of_file(ArtefactRole::IdentifiedRobot, &robot))
            .transpose()?;
        certificate =
            certificate.with_check(&text, robot.as_ref()).map_err(|why| Diagnostic::file(&file, why))?;
    }
    if let Some(path) = &args.identity {
        certificate = certificate.with_identity(&artefact::identity(path)?);
    }
    out.findings(certificate.findings());
    out.findings(certificate.identity().old_certificate(&date::utc(clock::unix_ns())));
    let dcc = certificate.dcc()?;
    let pdf = certificate.pdf(&dcc)?;
    let mut set = FileSet::begin(&args.out)?;
    set.write("certificate.html", certificate.html()?)?;
    set.write("dcc.xml", dcc)?;
    let mut written = vec!["certificate.html", "dcc.xml"];
    match pdf {
        Some(pdf) => {
            set.write("certificate.pdf", pdf)?;
            written.push("certificate.pdf");
        }
        None => out.finding(CertificateFinding::NoPdf),
    }
    set.finish()?;
    out.document(&json!({ "files": written }))?;
    out.result(format!(
        "{} in {}: a draft, not accredited, not signed",
        written.join(", "),
        args.out.display()
    ));
    Ok(CommandOutcome::Done)
}
