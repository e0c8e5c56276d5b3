//! `cargo xtask package`: the program as a static archive and as a Debian package, both installed and tried in a clean root.

mod debian;
mod linked;
mod notices;
mod sbom;
mod trial;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::files::{copy, copy_folder, remove_folder, write};
use crate::workspace::{Workspace, run_visibly};

/// Files of the root that a release contains as documentation.
const DOCUMENTS: [&str; 7] =
    ["README.md", "ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "LICENSE-MIT", "LICENSE-APACHE"];

/// Folders of the root that a release contains.
const FOLDERS: [&str; 2] = ["docs", "configs"];

/// Whether a release contains this path from the root as documentation.
pub fn is_shipped(path: &str) -> bool {
    let first = path.split('/').next().unwrap_or_default();
    DOCUMENTS.contains(&path) || FOLDERS.contains(&first)
}

/// Builds the release: a static archive (.tar.gz) and a Debian package (.deb), in target/package.
///
/// Both contain the program with its built-in setups, robot files and boards, manual pages, completion scripts, documentation,
/// licences, a list of all its crates (CycloneDX), and the files of configs/deploy. The program is linked statically: it needs no library of the host. Afterwards the
/// command unpacks the archive in an empty root, installs the package in a fresh Debian (needs debootstrap, root and a network),
/// and runs the program in both.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Build only; skip the trial.
    #[arg(long)]
    build_only: bool,
    /// Only check that every crate can be published: package all crates and build each from its package (`cargo publish --dry-run`).
    #[arg(long, conflicts_with = "build_only")]
    crates: bool,
    /// Debian mirror for the trial.
    #[arg(long, default_value = "http://deb.debian.org/debian")]
    mirror: String,
}

/// Contents of a release.
struct Release {
    version: String,
    /// Target triple.
    triple: String,
    /// The static program.
    program: PathBuf,
    /// Folder of all files below.
    folder: PathBuf,
}

/// # Errors
/// If the program does not build, a file cannot be written, or the installed program does not work.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    if args.crates {
        return try_to_publish(workspace);
    }
    let release = build(workspace)?;
    let tree = stage(workspace, &release)?;
    let archive = archive(workspace, &release, &tree)?;
    println!("{}", size_of(&archive)?);
    if !args.build_only {
        trial::of_archive(workspace, &release, &archive)?;
    }
    let package = debian::build(workspace, &release, &tree)?;
    println!("{}", size_of(&package)?);
    if !args.build_only {
        trial::of_package(workspace, &release, &package, &args.mirror)?;
    }
    Ok(())
}

/// Packages every crate and builds it from its package, in one call; publishes nothing.
fn try_to_publish(workspace: &Workspace) -> anyhow::Result<()> {
    let mut cargo = workspace.cargo();
    cargo.args(["publish", "--workspace", "--dry-run", "--locked", "--allow-dirty"]);
    // As in the workspace: without the patch a build generates the kernel's structures again, which needs libclang.
    let vendored = workspace.root().join("hal/vendor/v4l2-sys-mit");
    cargo.arg("--config").arg(format!("patch.crates-io.v4l2-sys-mit.path={:?}", vendored.display().to_string()));
    run_visibly(&mut cargo)
}

fn build(workspace: &Workspace) -> anyhow::Result<Release> {
    let rustc = workspace.output_of("rustc", &["-vV"]).context("rustc does not print its version")?;
    let triple = rustc
        .lines()
        .find_map(|line| line.strip_prefix("host: "))
        .context("the output of rustc has no host")?
        .to_owned();
    let metadata = workspace.metadata()?;
    let packages = metadata["packages"].as_array().context("`packages` is missing from cargo metadata")?;
    let program = packages.iter().find(|package| package["name"] == linked::PROGRAM);
    let version = program.and_then(|package| package["version"].as_str()).context("pb3dp has no version")?.to_owned();
    let folder = workspace.target_folder()?.join("package");
    let cargo_target = workspace.target_folder()?.join("package-build");
    let mut cargo = workspace.cargo();
    // With --target these flags do not apply to build scripts and macros, which cannot be static.
    cargo.env("RUSTFLAGS", "-C target-feature=+crt-static").env("CARGO_TARGET_DIR", &cargo_target);
    cargo.args(["build", "--release", "--locked", "--target", &triple, "--package", linked::PROGRAM, "--bin", "pb3dp"]);
    run_visibly(&mut cargo)?;
    let program = cargo_target.join(&triple).join("release/pb3dp");
    Ok(Release { version, triple, program, folder })
}

/// Copies all files to their places below a prefix (`/usr`, `/usr/local`); returns the prefix.
fn stage(workspace: &Workspace, release: &Release) -> anyhow::Result<PathBuf> {
    let tree = release.folder.join(format!("pb3dp-{}-{}", release.version, release.triple));
    remove_folder(&tree)?;
    let program = tree.join("bin/pb3dp");
    copy(&release.program, &program)?;
    run_visibly(workspace.command("strip").arg(&program))?;
    let generated = release.folder.join("generated");
    run_visibly(workspace.command(&program).arg("generate").arg(&generated))?;
    copy_folder(&generated.join("man"), &tree.join("share/man/man1"))?;
    for (from, to) in [
        ("pb3dp.bash", "share/bash-completion/completions/pb3dp"),
        ("_pb3dp", "share/zsh/site-functions/_pb3dp"),
        ("pb3dp.fish", "share/fish/vendor_completions.d/pb3dp.fish"),
    ] {
        copy(&generated.join("completions").join(from), &tree.join(to))?;
    }
    let documentation = tree.join("share/doc/pb3dp");
    for name in DOCUMENTS {
        copy(&workspace.root().join(name), &documentation.join(name))?;
    }
    for name in FOLDERS {
        copy_folder(&workspace.root().join(name), &documentation.join(name))?;
    }
    write(&documentation.join("THIRD-PARTY.txt"), &notices::text(workspace)?)?;
    write(&documentation.join("sbom.cdx.json"), &sbom::text(workspace)?)?;
    Ok(tree)
}

/// Packs the tree so that equal contents give equal bytes.
fn archive(workspace: &Workspace, release: &Release, tree: &Path) -> anyhow::Result<PathBuf> {
    let name = tree.file_name().and_then(|name| name.to_str()).context("the tree has no name")?;
    let archive = release.folder.join(format!("{name}.tar.gz"));
    let time = workspace.output_of("git", &["log", "-1", "--format=%ct"]).unwrap_or_else(|| "0".to_owned());
    let mut tar = workspace.command("tar");
    tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--mode=u+rwX,go+rX,go-w"]);
    tar.arg(format!("--mtime=@{time}")).arg("-C").arg(&release.folder).args(["-czf"]).arg(&archive).arg(name);
    run_visibly(&mut tar)?;
    Ok(archive)
}

fn size_of(file: &Path) -> anyhow::Result<String> {
    let bytes = fs::metadata(file).with_context(|| format!("cannot find {}", file.display()))?.len();
    Ok(format!("{}: {:.1} MB", file.display(), bytes as f64 / 1e6))
}
