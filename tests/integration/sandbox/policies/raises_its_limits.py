# expect: harmless
# where: episode
import resource


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        found = 0
        for kind in (resource.RLIMIT_AS, resource.RLIMIT_NPROC, resource.RLIMIT_FSIZE, resource.RLIMIT_CPU, resource.RLIMIT_NOFILE):
            try:
                resource.setrlimit(kind, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
                found += 1
            except (ValueError, OSError):
                pass
        return [float(found), 0.0, 0.0]
