//! Writes the draft of a calibration certificate from a result.

use std::path::{Path, PathBuf};

use dbbd_device::clock;
use dbbd_model::base::date;
use dbbd_model::base::serialised::Seal;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::ArtefactRole;
use serde::{Deserialize, Serialize};

use super::identify::ROBOT;
use super::{AnswerOutcome, RequestResult, RequestSession, earlier};
use crate::file_set::{EarlierFiles, FileSet};
use crate::files;
use crate::report::certificate::{Certificate, CertificateFinding};
use crate::robot_files::last_check;

/// Which results a certificate states.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CertificateRequest {
    /// `result.json`, or its directory.
    pub result: PathBuf,
    /// The directory of the certificate.
    pub out: PathBuf,
    /// `check.json`, or its directory, whose decision is added; `None` for the newest check of this calibration beside it.
    pub check: Option<PathBuf>,
    /// A file with the identity of robot, bar and laboratory, in place of the identity in the result.
    pub identity: Option<PathBuf>,
    /// A specimen in place of a certificate; only this may state simulated readings.
    #[serde(default)]
    pub specimen: bool,
    /// Replace the files of an earlier result; otherwise they are kept beside it.
    #[serde(default)]
    pub replace: bool,
}

/// The names of the files of a certificate.
#[derive(Clone, Debug, Serialize)]
pub struct CertificateDocument {
    pub files: Vec<String>,
}

impl CertificateRequest {
    pub(super) fn result(
        &self,
        session: &RequestSession<'_>,
    ) -> Result<RequestResult<CertificateDocument>, Diagnostic> {
        let today = date::utc(clock::unix_ns());
        let certificate = self.certificate(&today)?;
        session.findings_in(self.result.display(), certificate.standing().finding(certificate.robot()));
        session.findings(certificate.findings());
        session.findings(certificate.identity().old_certificate(&today));
        let dcc = certificate.dcc()?;
        let pdf = certificate.pdf(&dcc)?;
        let mut set = FileSet::begin(&self.out, EarlierFiles::kept_unless(self.replace))?;
        set.write("certificate.html", certificate.html()?)?;
        set.write("dcc.xml", dcc)?;
        match pdf {
            Some(pdf) => set.write("certificate.pdf", pdf)?,
            None => session.finding(CertificateFinding::NoPdf),
        }
        let files = set.finish()?;
        let document = CertificateDocument { files: files.clone() };
        Ok(RequestResult { outcome: AnswerOutcome::Done, files, document })
    }

    fn certificate(&self, today: &str) -> Result<Certificate, Diagnostic> {
        let (certificate_of, text) = read_named_file(&self.result, "result.json")?;
        let mut certificate =
            Certificate::read(&text, today).map_err(|why| Diagnostic::file(&certificate_of, why))?;
        let robot = Path::new(&certificate_of).with_file_name(ROBOT);
        let last_check = || Ok::<_, Diagnostic>(last_check(&robot)?.map(|(path, _)| path));
        let check = self.check.clone().map_or_else(last_check, |path| Ok(Some(path)))?;
        if let Some(path) = &check {
            let (file, text) = read_named_file(path, "check.json")?;
            let robot = robot
                .is_file()
                .then(|| crate::artefact::of_file(ArtefactRole::IdentifiedRobot, &robot))
                .transpose()?;
            certificate =
                certificate.with_check(&text, robot.as_ref()).map_err(|why| Diagnostic::file(&file, why))?;
        }
        if let Some(path) = &self.identity {
            certificate = certificate.with_identity(&earlier::read_identity(path)?);
        }
        if self.specimen {
            certificate = certificate.specimen();
        }
        certificate.check_origin().map_err(|why| Diagnostic::file(&certificate_of, why))?;
        Ok(certificate)
    }
}

/// The name and the text of a file, which may be named by its directory.
fn read_named_file(path: &Path, name: &str) -> Result<(String, String), Diagnostic> {
    let path = if path.is_dir() { path.join(name) } else { path.to_owned() };
    let (name, text) = (path.display().to_string(), files::read_text(&path)?);
    Seal::Json.check(&text).map_err(|finding| Diagnostic::file(&name, finding))?;
    Ok((name, text))
}
