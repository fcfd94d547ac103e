//! `dbbd certificate`.

use std::path::{Path, PathBuf};

use super::CommandOutput;
use dbbd_job::request::Request;
use dbbd_job::request::certificate::{CertificateDocument, CertificateRequest};

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
    /// check.json of `dbbd check`, or its directory: adds its decision and decision rule [default: the newest check of this
    /// calibration in a directory beside RESULT, if there is one].
    #[arg(long, value_name = "CHECK.json")]
    check: Option<PathBuf>,
    /// Serial numbers, laboratory, customer, operator, date and so on, in place of those in the result: a TOML file with the
    /// keys of a job's table [identity].
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
    /// Write a specimen, which states on each page that it is none and has neither number nor traceability: how a certificate
    /// looks. A certificate of simulated readings is refused.
    #[arg(long)]
    specimen: bool,
    /// Replace an earlier result in DIR [default: its files move to DIR/previous-1, DIR/previous-2 and so on].
    #[arg(long)]
    replace: bool,
}

/// What the arguments ask for.
pub(super) fn request(args: &CertificateArgs) -> Request {
    Request::Certificate(CertificateRequest {
        result: args.result.clone(),
        out: args.out.clone(),
        check: args.check.clone(),
        identity: args.identity.clone(),
        specimen: args.specimen,
        replace: args.replace,
    })
}

pub(super) fn show(out: &CommandOutput, document: &CertificateDocument, directory: &Path) {
    out.result(format!(
        "{} in {}: a draft, not accredited, not signed",
        document.files.join(", "),
        directory.display()
    ));
}
