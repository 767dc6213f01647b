// What an extension module was built from: setup.py hashes its sources, and jobs take the hash for the identity of its code
// (ggvs_eval/tasks/identity.py, which reads it from the file), so that equal code has equal results for every compiler.
#pragma once

namespace ggvs {

[[gnu::used]] inline constexpr char kSources[] = "ggvs-eval sources " GGVS_EVAL_SOURCES;

}  // namespace ggvs
