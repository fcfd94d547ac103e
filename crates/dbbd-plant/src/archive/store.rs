//! The object store: a directory or an S3 bucket. Objects are named by their SHA-256.

use dbbd_model::base::text::unreadable;
use std::fs::File;
use std::future::Future;
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use futures_util::StreamExt as _;
use object_store::aws::AmazonS3Builder;
use object_store::local::LocalFileSystem;
use object_store::{
    Error, ObjectStore, ObjectStoreExt as _, RetryConfig, WriteMultipart, path::Path as Place,
};
use tokio::runtime::{Builder, Runtime};

use super::address::StoreAddress;
use crate::ArchiveFinding::{
    ChangedMeanwhile, Differs, Missing, NotAnAddress, NotReached, StoreNotInitialised, StoreRefused,
};
use dbbd_job::files;
use dbbd_model::base::FileFinding;
use dbbd_model::base::InternalFinding;
use dbbd_model::base::hash::{Sha256, sha256};
use dbbd_model::diagnostic::Diagnostic;

/// Size of the parts of an upload, bytes, and their number at a time.
const PART: usize = 8 << 20;
const PARTS_AT_A_TIME: usize = 4;
/// Time for the retries of a failed request.
const STORE_RETRY_TIMEOUT: Duration = Duration::from_secs(20);
const TRIES: usize = 4;
/// The object that marks an initialised store.
const MARK: &str = "dbbd archive\n";

pub struct Store {
    objects: Arc<dyn ObjectStore>,
    prefix: String,
    is_directory: bool,
    runtime: Runtime,
}

impl Store {
    pub(super) fn open(address: &StoreAddress) -> Result<Self, Diagnostic> {
        let runtime = Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| InternalFinding::NoSystem { why: error.to_string() })?;
        let wrong = |error: Error| NotAnAddress { option: "store".into(), why: error.to_string() };
        let (objects, prefix, is_directory): (Arc<dyn ObjectStore>, _, _) = match address {
            StoreAddress::Directory(path) => {
                files::directory(path)?;
                let directory = LocalFileSystem::new_with_prefix(path).map_err(wrong)?.with_fsync(true);
                (Arc::new(directory), String::new(), true)
            }
            StoreAddress::S3 { bucket, prefix, keys } => {
                // Fails if another part of this program has installed it already.
                let _ = rustls::crypto::ring::default_provider().install_default();
                let retry = RetryConfig {
                    max_retries: TRIES,
                    retry_timeout: STORE_RETRY_TIMEOUT,
                    ..Default::default()
                };
                let mut builder = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(retry);
                if let Some([id, key]) = keys {
                    builder = builder.with_access_key_id(id).with_secret_access_key(key);
                }
                (Arc::new(builder.build().map_err(wrong)?), prefix.clone(), false)
            }
        };
        Ok(Self { objects, prefix, is_directory, runtime })
    }

    fn place(&self, sha256: &str) -> Place {
        let prefix = if self.prefix.is_empty() { String::new() } else { format!("{}/", self.prefix) };
        Place::from(format!("{prefix}objects/{}/{sha256}", sha256.get(..2).unwrap_or_default()))
    }

    fn wait<T>(&self, object: &str, work: impl Future<Output = Result<T, Error>>) -> Result<T, Diagnostic> {
        self.runtime.block_on(work).map_err(|error| self.wrong(object, &error))
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "the kinds of errors of the crate are open")]
    fn wrong(&self, object: &str, error: &Error) -> Diagnostic {
        let object = object.to_owned();
        match error {
            Error::NotFound { .. } => Missing { object }.into(),
            Error::Generic { .. } if !self.is_directory => {
                NotReached { what: "the store".into(), why: innermost(error) }.into()
            }
            _ => StoreRefused { object, why: innermost(error) }.into(),
        }
    }

    /// Writes the mark and reads it back.
    pub(super) fn check(&self) -> Result<(), Diagnostic> {
        let name = sha256(MARK);
        self.put(&name, &mut MARK.as_bytes(), MARK.len() as u64)?;
        self.verify(&name)
    }

    /// Checks for the mark, which a mistyped address does not have.
    pub(super) fn check_mark(&self) -> Result<(), Diagnostic> {
        let is_marked = self.holds(&sha256(MARK), MARK.len() as u64)?;
        if is_marked { Ok(()) } else { Err(StoreNotInitialised.into()) }
    }

    /// Whether the store has an object of this size.
    pub(super) fn holds(&self, sha256: &str, bytes: u64) -> Result<bool, Diagnostic> {
        match self.runtime.block_on(self.objects.head(&self.place(sha256))) {
            Ok(found) => Ok(found.size == bytes),
            Err(Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(self.wrong(sha256, &error)),
        }
    }

    /// Stores the content of `from` atomically. Its SHA-256 must be `name`.
    pub(super) fn put(&self, name: &str, from: &mut dyn Read, bytes: u64) -> Result<(), Diagnostic> {
        let place = self.place(name);
        if bytes <= PART as u64 {
            let mut content = Vec::new();
            from.read_to_end(&mut content).map_err(unreadable(name))?;
            if sha256(&content) != name {
                return Err(Diagnostic::file(name, ChangedMeanwhile));
            }
            return self.wait(name, self.objects.put(&place, content.into())).map(drop);
        }
        let upload = self.wait(name, self.objects.put_multipart(&place))?;
        let sent = self.runtime.block_on(async {
            let mut parts = WriteMultipart::new_with_chunk_size(upload, PART);
            let (mut piece, mut hash) = (vec![0; 1 << 18], Sha256::default());
            loop {
                let read = match from.read(&mut piece) {
                    Ok(0) => break,
                    Ok(read) => piece.get(..read).unwrap_or_default(),
                    Err(error) => {
                        // An error of the abort is less important than its reason.
                        let _ = parts.abort().await;
                        return Err(unreadable(name)(error));
                    }
                };
                hash.update(read);
                parts.wait_for_capacity(PARTS_AT_A_TIME).await.map_err(|error| self.wrong(name, &error))?;
                parts.write(read);
            }
            if hash.finish() != name {
                let _ = parts.abort().await;
                return Err(Diagnostic::file(name, ChangedMeanwhile));
            }
            parts.finish().await.map_err(|error| self.wrong(name, &error))
        });
        sent.map(drop)
    }

    /// Reads an object in pieces and checks its SHA-256.
    fn read(&self, name: &str, mut to: impl FnMut(&[u8]) -> std::io::Result<()>) -> Result<(), Diagnostic> {
        let found = self.runtime.block_on(async {
            let mut hash = Sha256::default();
            let got = self.objects.get(&self.place(name)).await.map_err(|error| self.wrong(name, &error))?;
            let mut pieces = got.into_stream();
            while let Some(piece) = pieces.next().await {
                let piece = piece.map_err(|error| self.wrong(name, &error))?;
                hash.update(&piece);
                to(&piece).map_err(|error| {
                    Diagnostic::file(name, FileFinding::Unwritable { why: error.to_string() })
                })?;
            }
            Ok::<_, Diagnostic>(hash.finish())
        })?;
        if found == name { Ok(()) } else { Err(Differs { object: name.into(), found }.into()) }
    }

    /// Reads an object and checks its SHA-256.
    pub(super) fn verify(&self, name: &str) -> Result<(), Diagnostic> {
        self.read(name, |_| Ok(()))
    }

    /// The content of a small object.
    pub(super) fn get(&self, name: &str) -> Result<Vec<u8>, Diagnostic> {
        let mut content = Vec::new();
        self.read(name, |piece| {
            content.extend_from_slice(piece);
            Ok(())
        })?;
        Ok(content)
    }

    /// Writes an object to a file atomically.
    pub(super) fn fetch(&self, name: &str, path: &Path) -> Result<(), Diagnostic> {
        let unwritable = files::unwritable(path);
        let mut beside = path.as_os_str().to_owned();
        beside.push(format!(".{}.part", std::process::id()));
        let mut file = File::create(&beside).map_err(&unwritable)?;
        let read = self.read(name, |piece| file.write_all(piece));
        let done = read.and_then(|()| std::fs::rename(&beside, path).map_err(&unwritable));
        if done.is_err() {
            // A partial file is useless.
            let _ = std::fs::remove_file(&beside);
        }
        done
    }
}

/// The root cause of an error.
fn innermost(error: &Error) -> String {
    let mut cause: &dyn std::error::Error = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}
