// Threads for many short jobs, one after the other, of one kernel: to start threads anew for each takes as long as the jobs do.
// They end with the kernel, so that, as in parallel.hpp, nothing survives a fork.
#pragma once
#include <algorithm>
#include <atomic>
#include <exception>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace ggvs {

class Crew {
public:
    explicit Crew(int threads) : failures_(std::max(threads, 1)) {
        helpers_.reserve(failures_.size() - 1);
        try {
            for (int worker = 1; worker < threads; ++worker) helpers_.emplace_back([this, worker] { help(worker); });
        } catch (const std::system_error&) {
            // The system grants no more threads: those that run do all the jobs.
        }
    }

    Crew(const Crew&) = delete;

    ~Crew() {
        over_ = true;
        for (auto& helper : helpers_) helper.join();
    }

    // Calls job(index, worker) for index < count as `parallel_for` does.
    template <class Job>
    void run(int count, const Job& job) {
        job_ = &job, count_ = count, next_ = 0;
        call_ = [](const void* what, int index, int worker) { (*static_cast<const Job*>(what))(index, worker); };
        ++turn_;
        door_ = kOpen;
        work(0);
        door_ -= kOpen;  // who has not come yet is not waited for: the system may have put it aside
        wait([this] { return door_ == 0; });
        for (auto& failure : failures_)
            if (failure) std::rethrow_exception(std::exchange(failure, nullptr));
    }

private:
    static constexpr int kOpen = 1, kInside = 2;  // the door's state: whether there is a job, and for each who is at it

    void help(int worker) {
        for (unsigned seen = 0;;) {
            wait([&] { return over_ || (turn_ != seen && (door_ & kOpen)); });
            if (over_) return;
            const unsigned turn = turn_;
            int door = door_;
            if (!(door & kOpen) || !door_.compare_exchange_strong(door, door + kInside)) continue;
            work(worker);
            door_ -= kInside;
            seen = turn;
        }
    }

    void work(int worker) {
        try {
            for (int index = next_++; index < count_; index = next_++) call_(job_, index, worker);
        } catch (...) {
            failures_[worker] = std::current_exception();
            next_ = count_;
        }
    }

    // Looks again and again, as the others are about to finish; gives way to whoever else wants the processor if they are not.
    template <class Condition>
    static void wait(const Condition& met) {
        constexpr int kLooks = 2000;
        for (int look = 0; !met(); ++look) {
            if (look >= kLooks) std::this_thread::yield();
#if defined(__x86_64__)
            __builtin_ia32_pause();
#endif
        }
    }

    std::vector<std::exception_ptr> failures_;
    std::atomic<unsigned> turn_{0};
    std::atomic<int> next_{0}, door_{0};
    std::atomic<bool> over_{false};
    const void* job_ = nullptr;
    void (*call_)(const void*, int, int) = nullptr;
    int count_ = 0;
    std::vector<std::thread> helpers_;
};

}  // namespace ggvs
