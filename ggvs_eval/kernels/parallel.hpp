// Jobs 0 .. count-1 on short-lived threads. Threads are started per call rather than kept: nothing then survives a fork, which
// a pool of worker processes needs and OpenMP's runtime does not offer, and starting them costs tens of microseconds.
#pragma once
#include <algorithm>
#include <atomic>
#include <exception>
#include <system_error>
#include <thread>
#include <vector>

namespace ggvs {

// Calls job(index, worker), worker < threads. Which worker takes which index is left to chance: a job's result must not depend on
// it.
template <class Job>
void parallel_for(int count, int threads, const Job& job) {
    threads = std::max(1, std::min(threads, count));
    std::atomic<int> next{0};
    std::vector<std::exception_ptr> failures(threads);
    auto work = [&](int worker) {
        try {
            for (int index = next++; index < count; index = next++) job(index, worker);
        } catch (...) {
            failures[worker] = std::current_exception();
            next = count;
        }
    };
    std::vector<std::thread> helpers;
    helpers.reserve(threads - 1);
    try {
        for (int worker = 1; worker < threads; ++worker) helpers.emplace_back(work, worker);
    } catch (const std::system_error&) {
        // The system grants no more threads: those that run do all the jobs.
    }
    work(0);
    for (auto& helper : helpers) helper.join();
    for (auto& failure : failures)
        if (failure) std::rethrow_exception(failure);
}

}  // namespace ggvs
